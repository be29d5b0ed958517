"""Compile the kernels of a flight into numba's disk cache before its processes start.

A first flight needs about 340 kernels. Without this step each process compiles its own on one core and reports nothing. Here
worker processes (see kernel_worker) run jobs on all cores: a job calls the kernels' callers with toy data. A finished job
leaves a stamp beside the kernels, and is skipped until a source, numba or the processor changes. If a source of a kernel has
changed, all kernels are compiled again (see kernel_sources). A kernel that no job compiles is compiled by the process that
calls it first.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import logging
import os
import platform
import queue
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from uav_recon.app.kernel_sources import remove_stale_kernels

LOG = logging.getLogger(__name__)

MAX_WORKERS = 4  # each holds about 0.7 GB
CACHE_VARIABLE = "NUMBA_CACHE_DIR"
POLL_S = 0.5
_WORKER_ENDED = "the worker process has ended"
PACKAGE = Path(__file__).parents[1]


@dataclass(frozen=True)
class KernelJob:
    """Kernels that one call compiles.

    function: MODULE:FUNCTION, called with the path of a config and argument.
    kernels: number of kernels that it compiles, for the progress.
    after: names of the jobs whose kernels these call.
    """

    name: str
    function: str
    kernels: int
    after: tuple[str, ...] = ()
    argument: str = ""


def log_failure(job: KernelJob, reason: str) -> None:
    """Log a job that failed: its kernels are left to the process that needs them."""
    LOG.warning("kernels of %s are not compiled ahead: %s", job.name, reason)


def use_writable_cache() -> None:
    """Choose a cache folder if the package cannot be written, for this and all child processes.

    Call it before a kernel is imported. By default numba uses a folder in the user's home, and without a home it cannot
    even import a kernel. The first usable one is taken: NUMBA_CACHE_DIR, the package, the user's cache folder, a private
    temporary folder.
    """
    if os.environ.get(CACHE_VARIABLE) or all(_writable(folder / "__pycache__") for folder in (PACKAGE, PACKAGE / "geometry")):
        return
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
    for folder in (home / "uav_recon" / "kernels", Path(tempfile.gettempdir()) / f"uav_recon-kernels-{os.getuid()}"):
        if _writable(folder) and _private(folder):  # anyone who can write there chooses the code that runs here
            os.environ[CACHE_VARIABLE] = str(folder)
            return


def are_compiled(jobs: Iterable[KernelJob]) -> bool:
    """Return whether nothing is left to compile."""
    return all(_is_stamped(job) for job in jobs)


def compile_kernels(
    jobs: Sequence[KernelJob],
    config_path: Path,
    show: Callable[[int, int], None],
    stopped: Callable[[], bool] = lambda: False,
    ended: Callable[[KernelJob], None] = lambda _job: None,
    failed: Callable[[KernelJob, str], None] = log_failure,
) -> None:
    """Compile what is not compiled yet.

    It blocks for two minutes on two cores the first time, for some milliseconds later on. show(done, total): the number of
    kernels, called at each one and every POLL_S; never called if all are compiled. Returns early once stopped(). ended(job):
    called when a job's kernels are in the cache, also for one that needs no compilation, and after failed(job, reason), which
    is called for a job that fails, also if no worker is left to run it.
    """
    if not are_compiled(jobs):
        remove_stale_kernels(_cache_roots(), _packages())
    todo = []
    for job in jobs:
        if _is_stamped(job):
            ended(job)
        else:
            todo.append(job)
    if not todo:
        return
    pool = _Pool(todo, config_path, min(MAX_WORKERS, len(os.sched_getaffinity(0)), len(todo)), ended, failed)
    total = sum(job.kernels for job in todo)
    try:
        while pool.busy() and not stopped():
            pool.step()
            show(min(pool.compiled, total), total)
    finally:
        pool.close()


class _Worker:
    """Process that runs jobs; kernel_worker describes its input and output."""

    def __init__(self, number: int, events: queue.Queue[tuple[int, str]]) -> None:
        self.job: KernelJob | None = None
        self._process = subprocess.Popen(
            [sys.executable, "-m", "uav_recon.app.kernel_worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,  # a terminal's Ctrl-C reaches only the waiting parent
        )
        self._listener = threading.Thread(target=self._listen, args=(number, events), name="kernel-worker", daemon=True)
        self._listener.start()

    def _listen(self, number: int, events: queue.Queue[tuple[int, str]]) -> None:
        pipe = self._process.stdout
        if pipe is not None:
            with pipe:
                for line in pipe:
                    events.put((number, line.strip()))
        events.put((number, "lost"))

    def start(self, job: KernelJob, config_path: Path) -> None:
        self.job = job
        if self._process.stdin is not None:
            with suppress(OSError):  # it has ended, which its listener reports
                self._process.stdin.write(json.dumps([job.function, str(config_path), job.argument]) + "\n")
                self._process.stdin.flush()

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
        self._listener.join()
        with suppress(OSError):  # a job that it never read
            if self._process.stdin is not None:
                self._process.stdin.close()


class _Pool:
    """Workers and waiting jobs; a job starts after the jobs that it depends on."""

    def __init__(
        self,
        jobs: list[KernelJob],
        config_path: Path,
        workers: int,
        ended: Callable[[KernelJob], None],
        failed: Callable[[KernelJob, str], None],
    ) -> None:
        self.compiled = 0
        self._ended = ended
        self._failed = failed
        self._waiting = list(jobs)
        self._config_path = config_path
        self._undone = {job.name for job in jobs}
        self._events: queue.Queue[tuple[int, str]] = queue.Queue()
        self._workers = {number: _Worker(number, self._events) for number in range(workers)}
        self._assign()

    def busy(self) -> bool:
        return any(worker.job is not None for worker in self._workers.values())

    def step(self) -> None:
        """Wait for one event, for at most POLL_S."""
        try:
            number, event = self._events.get(timeout=POLL_S)
        except queue.Empty:
            return
        worker = self._workers[number]
        if event == "compiled":
            self.compiled += 1
        elif worker.job is not None:
            self._end(worker.job, event)
            worker.job = None
        if event == "lost":
            self._workers.pop(number).kill()
        self._assign()
        while self._waiting and not self._workers:
            self._end(self._waiting.pop(0), "lost")

    def _end(self, job: KernelJob, event: str) -> None:
        self._undone.discard(job.name)
        if event == "done":
            _stamp(job)
        else:
            self._failed(job, _WORKER_ENDED if event == "lost" else event)
        self._ended(job)

    def _assign(self) -> None:
        for worker in self._workers.values():
            job = None if worker.job else next((job for job in self._waiting if not self._undone & set(job.after)), None)
            if job is not None:
                self._waiting.remove(job)
                worker.start(job, self._config_path)

    def close(self) -> None:
        for worker in self._workers.values():
            worker.kill()


def log_progress(logger: logging.Logger) -> Callable[[int, int], None]:
    """Return a show() for a process without a terminal.

    It logs one line at each tenth of the kernels.
    """
    logged = [-1]

    def show(done: int, total: int) -> None:
        tenth = 10 * done // max(total, 1)
        if tenth > logged[0]:
            logged[0] = tenth
            logger.warning("%s", progress_text(done, total))

    return show


def progress_text(done: int, total: int) -> str:
    """Return 'compiling kernels 23/61 (first run only)'."""
    return f"compiling kernels {done}/{total} (first run only)"


# -- stamps -------------------------------------------------------------------------------------------------------------


def _is_stamped(job: KernelJob) -> bool:
    """Return whether the job is done for these sources on this machine.

    Its kernels must still be in the cache, too.
    """
    try:
        stamp = json.loads(_stamp_path(job).read_text(encoding="utf-8"))
        return bool(stamp["of"] == _fingerprint()) and _count_indices() >= int(stamp["indices"])
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _stamp(job: KernelJob) -> None:
    path = _stamp_path(job)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({"of": _fingerprint(), "indices": _count_indices()}), encoding="utf-8")
    except OSError as error:
        LOG.warning("%s: cannot be written (%s): kernels are looked for again at each start", path, error.strerror)


def _stamp_path(job: KernelJob) -> Path:
    return _cache_roots()[0] / "__pycache__" / f"kernels-{job.name.replace(' ', '-')}.json"


def _cache_roots() -> list[Path]:
    """Return the folders below which numba keeps its index files."""
    chosen = os.environ.get(CACHE_VARIABLE)
    return [Path(chosen)] if chosen else [PACKAGE, PACKAGE.parent / "sitl"]


def _count_indices() -> int:
    """Count numba's index files, one for each compiled kernel."""
    return sum(name.endswith(".nbi") for root in _cache_roots() for _, _, names in os.walk(root) for name in names)


@cache
def _fingerprint() -> str:
    """Return a digest of the inputs of a compilation.

    Inputs are the sources, the versions of Python and of numba's packages, and the processor.
    """
    words = [platform.python_version(), *(importlib.metadata.version(name) for name in ("numba", "llvmlite", "numpy"))]
    with suppress(OSError):
        cpu = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace").splitlines()
        words += sorted({line for line in cpu if line.startswith(("model name", "flags", "Features", "CPU part"))})
    for source in _sources():
        stat = source.stat()
        words.append(f"{source} {stat.st_size} {stat.st_mtime_ns}")
    return hashlib.sha256("\n".join(words).encode()).hexdigest()


def _sources() -> Iterable[Path]:
    return sorted(path for package in _packages() for path in package.rglob("*.py"))


def _packages() -> list[Path]:
    return [path for path in (PACKAGE, PACKAGE.parent / "sitl") if path.is_dir()]


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _private(folder: Path) -> bool:
    """Return whether only this user can write there."""
    stat = folder.lstat()
    return not folder.is_symlink() and stat.st_uid == os.getuid() and not stat.st_mode & 0o022
