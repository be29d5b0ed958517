"""The kernels of a flight are compiled ahead, each once, in processes of their own."""

from __future__ import annotations

import logging
import os
import tempfile
from pathlib import Path

import pytest
import typer

from sitl.apps import kernel_compilation
from uav_recon.app import kernel_cache
from uav_recon.app.kernel_cache import KernelJob, compile_kernels, log_progress, use_writable_cache
from uav_recon.cli.simulate import compile_kernels as compile_command

MODULE = """
import numba
from pathlib import Path

def mark(config_path, argument):
    path = Path(config_path)
    path.write_text(path.read_text() + argument + " ")

def fail(config_path, argument):
    raise ValueError("no such luck")

def end(config_path, argument):
    import os
    os._exit(1)

def compile_one(config_path, argument):
    import uav_recon.geometry.rows as rows
    import numpy as np
    rows.copy_row(np.zeros((2, 3)), 0, np.zeros(3))
"""


@pytest.fixture
def config_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty file for the jobs, a module with jobs, and a cache of kernels of its own."""
    (tmp_path / "toy_jobs.py").write_text(MODULE, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    monkeypatch.setenv(kernel_cache.CACHE_VARIABLE, str(tmp_path / "kernels"))
    path = tmp_path / "config.toml"
    path.write_text("", encoding="utf-8")
    return path


def test_a_job_waits_for_those_that_it_needs_and_is_not_repeated(config_path: Path) -> None:
    first = KernelJob("first", "toy_jobs:mark", 1, argument="first")
    second = KernelJob("second", "toy_jobs:mark", 1, ("first",), "second")
    shown: list[tuple[int, int]] = []
    compile_kernels([second, first], config_path, lambda *progress: shown.append(progress))
    assert config_path.read_text(encoding="utf-8").split() == ["first", "second"]
    assert shown[-1] == (0, 2)
    shown.clear()
    compile_kernels([second, first], config_path, lambda *progress: shown.append(progress))
    assert config_path.read_text(encoding="utf-8").split() == ["first", "second"]
    assert not shown


def test_a_job_that_fails_is_logged_and_tried_again(config_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    job = KernelJob("failing", "toy_jobs:fail", 1)
    for _ in range(2):
        caplog.clear()
        compile_kernels([job], config_path, lambda *_: None)
        assert "kernels of failing are not compiled ahead: ValueError: no such luck" in caplog.text


def test_jobs_fail_when_their_workers_end(config_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel_cache, "MAX_WORKERS", 1)
    jobs = [KernelJob("ending", "toy_jobs:end", 1), KernelJob("waiting", "toy_jobs:mark", 1, argument="waiting")]
    failed: list[str] = []
    compile_kernels(jobs, config_path, lambda *_: None, failed=lambda job, reason: failed.append(f"{job.name}: {reason}"))
    assert failed == ["ending: the worker process has ended", "waiting: the worker process has ended"]


def test_the_compile_command_names_what_failed_and_exits_with_1(
    config_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    jobs = [KernelJob("one", "toy_jobs:mark", 1, argument="one"), KernelJob("failing", "toy_jobs:fail", 1)]
    monkeypatch.setattr(kernel_compilation, "flight_jobs", lambda: jobs)
    with pytest.raises(typer.Exit) as ended:
        compile_command()
    assert ended.value.exit_code == 1
    out, err = capsys.readouterr()
    assert err == "uav-recon: kernels are not compiled: failing (ValueError: no such luck)\n"
    assert "all kernels" not in out


def test_compiled_kernels_are_counted_and_looked_for(config_path: Path) -> None:
    job, shown = KernelJob("one", "toy_jobs:compile_one", 1), list[tuple[int, int]]()
    compile_kernels([job], config_path, lambda *progress: shown.append(progress))
    assert shown[-1] == (1, 1)
    for path in config_path.parent.rglob("*.nbi"):
        path.unlink()
    shown.clear()
    compile_kernels([job], config_path, lambda *progress: shown.append(progress))
    assert shown[-1] == (1, 1)


def test_a_start_that_is_stopped_compiles_no_further(config_path: Path) -> None:
    job = KernelJob("one", "toy_jobs:mark", 1, argument="one")
    compile_kernels([job], config_path, lambda *_: None, lambda: True)
    assert not kernel_cache._is_stamped(job)


def test_the_log_has_a_line_for_each_tenth(caplog: pytest.LogCaptureFixture) -> None:
    show = log_progress(logging.getLogger("test"))
    for done in range(101):
        show(done, 100)
    assert len(caplog.messages) == 11
    assert caplog.messages[2] == "compiling kernels 20/100 (first run only)"


def test_where_the_package_cannot_be_written_kernels_go_to_the_users_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(kernel_cache.CACHE_VARIABLE, "")  # not delenv, which would not undo what use_writable_cache() sets
    (tmp_path / "file").touch()
    monkeypatch.setattr(kernel_cache, "PACKAGE", tmp_path / "file")  # nothing can be made below it, even by root
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    use_writable_cache()
    assert os.environ[kernel_cache.CACHE_VARIABLE] == str(tmp_path / "home" / "uav_recon" / "kernels")
    monkeypatch.setenv(kernel_cache.CACHE_VARIABLE, "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path))
    use_writable_cache()
    folder = Path(os.environ[kernel_cache.CACHE_VARIABLE])
    assert folder.parent == tmp_path
    assert folder.stat().st_mode & 0o777 == 0o700


def test_a_chosen_folder_and_a_writable_package_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(kernel_cache.CACHE_VARIABLE, "chosen")
    use_writable_cache()
    assert os.environ[kernel_cache.CACHE_VARIABLE] == "chosen"
    monkeypatch.delenv(kernel_cache.CACHE_VARIABLE)
    monkeypatch.setattr(kernel_cache, "PACKAGE", tmp_path)
    use_writable_cache()
    assert not os.environ.get(kernel_cache.CACHE_VARIABLE)


def test_a_folder_that_others_may_write_is_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(kernel_cache.CACHE_VARIABLE, "")  # not delenv, which would not undo what use_writable_cache() sets
    (tmp_path / "file").touch()
    monkeypatch.setattr(kernel_cache, "PACKAGE", tmp_path / "file")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path))
    folder = tmp_path / f"uav_recon-kernels-{os.getuid()}"
    folder.mkdir()
    folder.chmod(0o777)
    use_writable_cache()
    assert not os.environ.get(kernel_cache.CACHE_VARIABLE)


def test_the_end_of_each_job_is_reported_also_if_it_is_compiled_or_fails(config_path: Path) -> None:
    jobs = [KernelJob("one", "toy_jobs:mark", 1, argument="one"), KernelJob("failing", "toy_jobs:fail", 1)]
    for _ in range(2):
        ended: list[KernelJob] = []
        compile_kernels(jobs, config_path, lambda *_: None, ended=ended.append)
        assert {job.name for job in ended} == {"one", "failing"}
        assert len(ended) == len(jobs)
