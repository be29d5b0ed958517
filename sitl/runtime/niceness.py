"""Niceness of another process."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path


def set_niceness(pid: int, niceness: int) -> None:
    """Set the niceness of a process that leads its own session, if permitted."""
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, pid, niceness)
    with contextlib.suppress(OSError):  # for kernels that schedule by session instead of by process: sched(7), autogroup
        Path(f"/proc/{pid}/autogroup").write_text(str(niceness), encoding="ascii")
