from __future__ import annotations

import ctypes
import gc
import json
import mmap
import resource
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from uav_recon.app import memory_lock

SETTLED = """
import ctypes, gc, json, mmap, resource, sys
from uav_recon.app import memory_lock
limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
room = mmap.mmap(-1, (1 << 20 if limit == resource.RLIM_INFINITY else limit) + 1)
place = ctypes.c_void_p(ctypes.addressof(ctypes.c_char.from_buffer(room)))
may = ctypes.CDLL(None).mlock2(place, ctypes.c_size_t(len(room)), 1) == 0
ctypes.CDLL(None).munlockall()
locked = memory_lock.lock_memory_and_freeze_gc()
made = bytearray(64 << 20)
status = open("/proc/self/status").read().splitlines()
kilobytes = int(next(line for line in status if line.startswith("VmLck")).split()[1])
print(json.dumps([may, locked, kilobytes, gc.get_freeze_count(), gc.isenabled()]))
"""


def test_memory_is_locked_and_objects_made_at_start_up_are_frozen_for_the_collector() -> None:
    """Runs in a separate process.

    The memory is locked if this user may lock it: with the limits of the pilot's unit, or as root.
    """
    child = subprocess.run([sys.executable, "-c", SETTLED], capture_output=True, text=True, timeout=60, check=True)
    may, locked, kilobytes, frozen, collects = json.loads(child.stdout)
    assert locked == may
    assert (kilobytes > 64 << 10) == may, "what comes later too"
    assert frozen > 1000
    assert collects


class Libc:
    """Stub of libc that accepts or refuses a lock and records the calls."""

    def __init__(self, refuses: bool = False) -> None:
        self.asked: list[tuple[Any, ...]] = []
        self._answer = -1 if refuses else 0

    def mlockall(self, flags: int) -> int:
        self.asked.append(("mlockall", flags))
        return self._answer

    def munlockall(self) -> int:
        self.asked.append(("munlockall",))
        return 0


@pytest.fixture
def thawed() -> Iterator[None]:
    yield
    gc.unfreeze()


@pytest.mark.usefixtures("thawed")
@pytest.mark.parametrize(("libc", "asked"), [(Libc(refuses=True), 1), (object(), 0)])
def test_without_permission_memory_is_not_locked(monkeypatch: pytest.MonkeyPatch, libc: object, asked: int) -> None:
    monkeypatch.setattr(ctypes, "CDLL", lambda name: libc)
    assert not memory_lock.lock_memory_and_freeze_gc()
    assert len(getattr(libc, "asked", [])) == asked


@pytest.mark.usefixtures("thawed")
@pytest.mark.parametrize("limit_bytes", [1 << 30, (1 << 63) - 1])
def test_with_a_limit_that_refuses_later_memory_nothing_stays_locked(monkeypatch: pytest.MonkeyPatch, limit_bytes: int) -> None:
    def refuse(number: int, length: int) -> mmap.mmap:
        if length > sys.maxsize:
            raise OverflowError
        raise OSError

    libc = Libc()
    monkeypatch.setattr(ctypes, "CDLL", lambda name: libc)
    monkeypatch.setattr(resource, "getrlimit", lambda which: (limit_bytes, limit_bytes))
    monkeypatch.setattr(mmap, "mmap", refuse)
    assert not memory_lock.lock_memory_and_freeze_gc()
    assert [word for word, *_ in libc.asked] == ["mlockall", "munlockall"]
