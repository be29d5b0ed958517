"""Disk cache of computed arrays; a cache that cannot be read or written only costs time."""

from __future__ import annotations

import hashlib
import logging
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl.runtime import atomic_file

Arrays = dict[str, NDArray[Any]]
LOG = logging.getLogger(__name__)


def cache_folder() -> Path:
    """Return the cache folder, below $XDG_CACHE_HOME or ~/.cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "uav_recon"


def key(*parts: NDArray[Any] | str) -> str:
    """Return the first 20 hexadecimal digits of the SHA-256 of the parts."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part.encode() if isinstance(part, str) else np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()[:20]


def cached(path: Path, dimensions: dict[str, int], make: Callable[[], Arrays]) -> Arrays:
    """Return the arrays stored in a file, or those of make(), which are then stored there.

    dimensions: ndim of each array by name.
    """
    arrays = _load(path, dimensions)
    if arrays is None:
        arrays = make()
        _save(path, arrays)
    return arrays


def _load(path: Path, dimensions: dict[str, int]) -> Arrays | None:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in dimensions}
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        LOG.warning("cache %s cannot be used (%s): it is computed again", path, error)
        return None
    if any(array.ndim != dimensions[name] for name, array in arrays.items()):
        LOG.warning("cache %s has wrong array shapes: it is computed again", path)
        return None
    return arrays


def _save(path: Path, arrays: Arrays) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file.writing(path) as file:
            np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    except OSError as error:
        LOG.warning("cache %s cannot be written (%s)", path, error)
