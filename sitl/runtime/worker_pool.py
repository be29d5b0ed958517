"""Pool of worker processes that end with their parent, at once and without output on Ctrl-C."""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing.process import BaseProcess
from typing import ParamSpec, TypeVar

from sitl.runtime.die_with_parent import set_parent_death_signal

P = ParamSpec("P")
T = TypeVar("T")

GRACE_S = 5.0  # time to clean up between SIGTERM and SIGKILL
SIGTERM_PERIOD_S = 0.25  # interval of the SIGTERMs


class WorkerPool:
    """Executor on the processes of worker_pool()."""

    def __init__(self, pool: ProcessPoolExecutor) -> None:
        self._pool = pool

    def submit(self, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Run work(*args, **kwargs) in a process as soon as one is free; return its Future."""
        # a process started by this call inherits the mask, so Ctrl-C cannot reach it before _init_worker()
        previous_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return self._pool.submit(_done, partial(work, *args, **kwargs))
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, previous_mask)


@contextmanager
def worker_pool(jobs: int) -> Iterator[WorkerPool]:
    """Yield a pool of `jobs` spawned processes. Enter it from the main thread.

    Each process has its own process group, so that a terminal's Ctrl-C reaches only the parent. If an exception leaves the
    block, the processes and all their children are ended within about GRACE_S.
    """
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        jobs, mp_context=multiprocessing.get_context("spawn"), initializer=_init_worker, initargs=(os.getpid(),)
    )
    try:
        yield WorkerPool(pool)
    except BaseException:
        _terminate(set(multiprocessing.active_children()) - others)
        pool.shutdown(cancel_futures=True)  # waits: CPython closes the pipe of its thread while the interpreter's end uses it
        raise
    pool.shutdown()


def _init_worker(chief: int) -> None:
    """Set up a new worker process: parent watch, own process group, signals, no log output."""
    set_parent_death_signal(chief)
    os.setpgrp()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    signal.signal(signal.SIGTERM, _leave)
    logging.getLogger().addHandler(logging.NullHandler())  # keeps warnings out of the parent's output


def _leave(*_: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise SystemExit(1)  # leaves every `with`, so that temporary folders are removed


def _done(work: Callable[[], T]) -> T:
    try:
        return work()
    finally:
        if signal.getsignal(signal.SIGTERM) is signal.SIG_IGN:  # after _leave(): the pool's worker loop would continue
            os._exit(1)


def _terminate(processes: Iterable[BaseProcess]) -> None:
    left = list(processes)
    for _ in range(int(GRACE_S / SIGTERM_PERIOD_S)):
        left = [process for process in left if _signal_group(process, signal.SIGTERM)]
        for process in left:
            process.join(SIGTERM_PERIOD_S / len(left))
    for process in left:
        _signal_group(process, signal.SIGKILL)


def _signal_group(process: BaseProcess, number: signal.Signals) -> bool:
    """Send a signal to a process and its group. Return False if none of them exists any more."""
    if process.pid is None:
        return False
    try:
        os.killpg(process.pid, number)
    except ProcessLookupError:  # all have ended, or the process has no group yet
        if not process.is_alive():
            return False
        with contextlib.suppress(ProcessLookupError):
            os.kill(process.pid, number)
    return True
