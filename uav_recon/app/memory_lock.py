"""A loop that waits neither for a page from disk nor for the garbage collector to look through what start-up made."""

from __future__ import annotations

import ctypes
import gc
import mmap
import resource

_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4  # MCL_* of linux/mman.h, on x86 and Arm


def lock_memory_and_freeze_gc() -> bool:
    """Call once everything is built: what is touched stays in memory from now on. True if the kernel agreed; never raises.

    The collector goes on, over what comes from now on: memory stays flat over hours.
    """
    gc.collect()
    gc.freeze()
    try:
        return _lock(ctypes.CDLL(None))
    except (OSError, AttributeError):  # a libc that does not have it
        return False


def _lock(libc: ctypes.CDLL) -> bool:
    """Under a limit of locked memory (LimitMEMLOCK=) what goes beyond it would not be allocated at all: then it is let go."""
    if libc.mlockall(_CURRENT | _FUTURE | _ON_FAULT) != 0:
        return False
    limit_bytes = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if limit_bytes == resource.RLIM_INFINITY:
        return True
    try:
        mmap.mmap(-1, limit_bytes + 1).close()  # root's goes beyond it
    except (OSError, OverflowError):
        libc.munlockall()
        return False
    return True
