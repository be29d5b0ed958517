"""Typed numba decorators of the simulator: kernels release the GIL and are cached on disk."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])

# nothing takes a kernel's C address, and the wrapper that offers it costs a tenth of the compilation
_OPTIONS = {"nogil": True, "cache": True, "no_cfunc_wrapper": True}


def kernel(function: F) -> F:
    """Compile for one core; no fastmath, so NaN keeps its meaning."""
    return cast("F", numba.njit(error_model="numpy", **_OPTIONS)(function))


def fast_kernel(function: F) -> F:
    """Compile with fastmath: only where no input can be NaN or infinite."""
    return cast("F", numba.njit(fastmath=True, **_OPTIONS)(function))
