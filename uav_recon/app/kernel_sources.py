"""Removal of compiled kernels whose sources have changed.

numba notices a change of the file that a kernel is in. It does not notice a change of a kernel in another file that was
inlined, nor of a constant that was imported: after an update in place it would go on with the old code. So the sources of all
kernels, and of what these import, have a digest beside the cache; if it differs, all compiled kernels are removed.
"""

from __future__ import annotations

import ast
import fcntl
import hashlib
import logging
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

LOG = logging.getLogger(__name__)

_DIGEST = "kernel-sources.sha256"
_LOCK = "kernel-sources.lock"
_COMPILED = (".nbi", ".nbc")
_MAKERS = frozenset({"numba", "uav_recon.geometry.jit"})  # a module that imports one of these holds kernels


def remove_stale_kernels(cache_roots: Sequence[Path], packages: Sequence[Path]) -> bool:
    """Remove compiled kernels if their sources are not those of the digest.

    Write the new digest.

    cache_roots: folders below which numba keeps its files; the digest is in the first one. packages: folders of the Python
    packages with kernels. Processes that start together wait for the first. Returns True if something was removed. A cache that
    cannot be written is logged and stays as it is.
    """
    digest = source_digest(packages)
    path = cache_roots[0] / "__pycache__" / _DIGEST
    try:
        with _locked(path.with_name(_LOCK)):
            if _read(path) == digest:
                return False
            removed = [file for root in cache_roots for file in _compiled(root)]
            for file in removed:
                file.unlink(missing_ok=True)
            path.write_text(digest, encoding="ascii")
    except OSError as error:
        LOG.warning("%s: cannot be written (%s): kernels of older sources may be used", path, error.strerror)
        return False
    if removed:
        LOG.warning("the sources of the kernels have changed: %d compiled kernels are removed", len(removed) // 2)
    return bool(removed)


def source_digest(packages: Sequence[Path]) -> str:
    """Return a digest of the kernels' sources and of the modules that they import.

    Without their comments.
    """
    text = hashlib.sha256()
    for name, path in sorted(kernel_sources(packages).items()):
        text.update(f"{name}\n{_module(path, path.stat().st_mtime_ns, path.stat().st_size)[0]}\n".encode())
    return text.hexdigest()


def kernel_sources(packages: Sequence[Path]) -> dict[str, Path]:
    """Return the modules that hold kernels.

    And those of the packages that these import, by their dotted names.
    """
    modules = {_dotted(path, package): path for package in packages for path in package.rglob("*.py")}
    imported = {name: _module(path, path.stat().st_mtime_ns, path.stat().st_size)[1] for name, path in modules.items()}
    found: set[str] = set()
    todo = [name for name, names in imported.items() if names & _MAKERS]
    while todo:
        name = todo.pop()
        if name not in found:
            found.add(name)
            todo += [other for other in imported[name] if other in modules]
    return {name: modules[name] for name in found}


@cache
def _module(path: Path, mtime_ns: int, size: int) -> tuple[str, frozenset[str]]:
    """Return the code of a module without comments and positions.

    And the dotted names that it imports.
    """
    tree = ast.parse(path.read_text(encoding="utf-8"))
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest(), frozenset(names)


def _dotted(path: Path, package: Path) -> str:
    parts = path.relative_to(package.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _compiled(root: Path) -> Iterable[Path]:
    return [path for path in root.rglob("*.nb[ic]") if path.suffix in _COMPILED]


def _read(path: Path) -> str:
    with suppress(OSError, UnicodeDecodeError):
        return path.read_text(encoding="ascii")
    return ""


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
