"""Typed numba decorators: each kernel releases the GIL and is cached on disk."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])

# nothing takes a kernel's C address, and the wrapper that offers it costs a tenth of the compilation
_OPTIONS = {"nogil": True, "cache": True, "no_cfunc_wrapper": True}


def kernel(function: F) -> F:
    """Compile for one core, without fastmath, so that NaN is handled correctly."""
    return cast("F", numba.njit(**_OPTIONS)(function))


def fast_kernel(function: F) -> F:
    """Compile with fastmath: only for kernels whose inputs cannot be NaN or infinite."""
    return cast("F", numba.njit(fastmath=True, **_OPTIONS)(function))
