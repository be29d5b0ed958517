"""Kernels of older sources: numba alone goes on with them, and the digest of the sources removes them."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from uav_recon.app import kernel_cache
from uav_recon.app.kernel_cache import KernelJob, compile_kernels
from uav_recon.app.kernel_sources import kernel_sources, remove_stale_kernels, source_digest

SCALE = "SCALE = {scale}\n"
CALLEE = """
import numba
from toy.scale import SCALE


@numba.njit(cache=True)
def inner(x):
    return {factor} * x * SCALE
"""
CALLER = """
import numba
from toy.callee import inner


@numba.njit(cache=True)
def outer(x):
    return inner(x)
"""


class Toy:
    """A package with a kernel that inlines another file's kernel and constant, and numba's cache of it."""

    def __init__(self, folder: Path) -> None:
        self.package, self.kernels = folder / "toy", folder / "kernels"
        self.package.mkdir()
        for name, text in (("__init__", ""), ("caller", CALLER), ("other", "X = 1\n")):
            (self.package / f"{name}.py").write_text(text)
        self.write(2, 1)

    def write(self, factor: int, scale: int) -> None:
        (self.package / "callee.py").write_text(CALLEE.format(factor=factor))
        (self.package / "scale.py").write_text(SCALE.format(scale=scale))

    def call(self) -> int:
        """Return outer(10) of a process of its own."""
        environment = os.environ | {
            "NUMBA_CACHE_DIR": str(self.kernels), "PYTHONPATH": str(self.package.parent),
            "PYTHONDONTWRITEBYTECODE": "1",  # bytecode of the same second and size would hide a change of the source
        }  # fmt: skip
        command = [sys.executable, "-c", "from toy.caller import outer; print(outer(10))"]
        return int(subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout)

    def remove_stale(self) -> bool:
        return remove_stale_kernels([self.kernels], [self.package])


@pytest.fixture
def toy(tmp_path: Path) -> Toy:
    return Toy(tmp_path)


@pytest.mark.parametrize(("factor", "scale"), [(3, 1), pytest.param(2, 5, marks=pytest.mark.nightly)])
def test_a_change_of_an_inlined_kernel_or_constant_is_seen(toy: Toy, factor: int, scale: int) -> None:
    assert not toy.remove_stale()
    assert toy.call() == 20
    toy.write(factor, scale)
    assert toy.call() == 20, "numba alone goes on with the old code: else this module is not needed"
    assert toy.remove_stale()
    assert toy.call() == 10 * factor * scale
    assert not toy.remove_stale()
    assert toy.call() == 10 * factor * scale


def test_kernels_of_an_unknown_age_are_removed(toy: Toy) -> None:
    """A cache from before there was a digest."""
    toy.call()
    assert toy.remove_stale()
    assert not list(toy.kernels.rglob("*.nb[ic]"))


def test_comments_and_modules_without_kernels_change_nothing(toy: Toy) -> None:
    before = source_digest([toy.package])
    assert set(kernel_sources([toy.package])) == {"toy.callee", "toy.caller", "toy.scale"}
    (toy.package / "other.py").write_text("X = 2\n")
    (toy.package / "caller.py").write_text(CALLER + "# a remark\n")
    assert source_digest([toy.package]) == before
    toy.write(2, 2)
    assert source_digest([toy.package]) != before


def test_the_products_kernels_and_what_they_import_are_found() -> None:
    found = kernel_sources(kernel_cache._packages())
    for name in ("uav_recon.geometry.jit", "uav_recon.geometry.traversal", "uav_recon.types.maps"):
        assert name in found
    assert "uav_recon.cli.main" not in found
    begin_s = time.perf_counter()
    source_digest(kernel_cache._packages())
    assert time.perf_counter() - begin_s < 2.0


def test_compile_removes_stale_kernels_before_its_jobs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stale = tmp_path / "kernels" / "geometry_0" / "rows.copy.nbi"
    stale.parent.mkdir(parents=True)
    stale.write_bytes(b"old")
    (tmp_path / "toy_jobs.py").write_text(
        textwrap.dedent(f"""
            from pathlib import Path

            def mark(config_path, argument):
                assert not Path({str(stale)!r}).exists()
        """)
    )
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    monkeypatch.setenv(kernel_cache.CACHE_VARIABLE, str(tmp_path / "kernels"))
    job = KernelJob("mark", "toy_jobs:mark", 1)
    compile_kernels([job], tmp_path / "config.toml", lambda *_: None)
    assert not stale.exists()
    assert kernel_cache.are_compiled([job])


def test_a_cache_that_cannot_be_written_is_logged(toy: Toy, caplog: pytest.LogCaptureFixture) -> None:
    toy.kernels.write_text("a file in place of the folder")
    assert not toy.remove_stale()
    assert "kernels of older sources may be used" in caplog.text
