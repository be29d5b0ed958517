"""Tests as another user of this machine; only root can become one."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator


@contextlib.contextmanager
def user(uid: int, gid: int) -> Iterator[None]:
    """Be another user, without further groups. Raises PermissionError for anybody but root."""
    groups = os.getgroups()
    os.setgroups([])
    os.setegid(gid)
    os.seteuid(uid)
    try:
        yield
    finally:
        os.seteuid(0)
        os.setegid(0)
        os.setgroups(groups)
