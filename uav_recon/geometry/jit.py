"""Typed numba decorators: each kernel releases the GIL and is cached on disk."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """Compile for one core, without fastmath, so that NaN is handled correctly."""
    return cast("F", numba.njit(nogil=True, cache=True)(function))


def fast_kernel(function: F) -> F:
    """Compile with fastmath: only for kernels whose inputs cannot be NaN or infinite."""
    return cast("F", numba.njit(nogil=True, cache=True, fastmath=True)(function))
