"""The outside world has its own typed door to numba: every kernel releases the GIL and is cached on disk."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """Compile for one core; no fastmath, so NaN keeps its meaning."""
    return cast("F", numba.njit(nogil=True, cache=True, error_model="numpy")(function))


def fast_kernel(function: F) -> F:
    """Compile with fastmath: only where no input can be NaN or infinite."""
    return cast("F", numba.njit(nogil=True, cache=True, fastmath=True)(function))
