"""Memory lock: a loop waits neither for disk pages nor for GC scans of start-up objects."""

from __future__ import annotations

import ctypes
import gc
import mmap
import resource

# MCL_* of linux/mman.h, on x86 and Arm
_CURRENT = 1
_FUTURE = 2
_ON_FAULT = 4


def lock_memory_and_freeze_gc() -> bool:
    """Lock the process's memory. Call it once everything is built.

    What is touched stays in memory from now on. Returns True if the kernel agreed; never raises.

    The garbage collector continues for new objects: memory stays flat over hours.
    """
    gc.collect()
    gc.freeze()
    try:
        return _lock(ctypes.CDLL(None))
    except (OSError, AttributeError):  # a libc that does not have it
        return False


def _lock(libc: ctypes.CDLL) -> bool:
    """Lock present and future pages.

    Under a limit of locked memory (LimitMEMLOCK=), an allocation beyond it would fail, so the lock is released then.
    """
    if libc.mlockall(_CURRENT | _FUTURE | _ON_FAULT) != 0:
        return False
    limit_bytes = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if limit_bytes == resource.RLIM_INFINITY:
        return True
    try:
        mmap.mmap(-1, limit_bytes + 1).close()  # root may exceed the limit
    except (OSError, OverflowError):
        libc.munlockall()
        return False
    return True
