"""Processes that work for this one, and end with it: at a Ctrl-C at once, without a word of their own."""

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

from sitl.runtime.die_with_parent import put_on

P = ParamSpec("P")
T = TypeVar("T")

GRACE_S, ASKED_EVERY_S = 5.0, 0.25  # to take down what they put up


class WorkerPool:
    """Takes work as an executor does."""

    def __init__(self, pool: ProcessPoolExecutor) -> None:
        self._pool = pool

    def submit(self, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Do it once a process is free."""
        heeded = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # by one that is started here, until it signs on
        try:
            return self._pool.submit(_done, partial(work, *args, **kwargs))
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, heeded)


@contextmanager
def worker_pool(jobs: int) -> Iterator[WorkerPool]:
    """Processes, spawned, each with a group of its own, so that a terminal's Ctrl-C reaches only who waits for them. To be
    entered by the main thread. Left by an exception, it ends them and all that they started, within some GRACE_S.
    """
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        jobs, mp_context=multiprocessing.get_context("spawn"), initializer=_sign_on, initargs=(os.getpid(),)
    )
    try:
        yield WorkerPool(pool)
    except BaseException:
        _dismiss(set(multiprocessing.active_children()) - others)
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


def _sign_on(chief: int) -> None:
    """In a new process."""
    put_on(chief)
    os.setpgrp()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    signal.signal(signal.SIGTERM, _leave)
    logging.getLogger().addHandler(logging.NullHandler())  # what it warns of means nothing between others' lines


def _leave(*_: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise SystemExit(1)  # through every `with`, so that no folder is left behind


def _done(work: Callable[[], T]) -> T:
    try:
        return work()
    finally:
        if signal.getsignal(signal.SIGTERM) is signal.SIG_IGN:  # dismissed: the pool's own loop would go on
            os._exit(1)


def _dismiss(processes: Iterable[BaseProcess]) -> None:
    left = list(processes)
    for _ in range(int(GRACE_S / ASKED_EVERY_S)):
        left = [process for process in left if _told(process, signal.SIGTERM)]
        for process in left:
            process.join(ASKED_EVERY_S / len(left))
    for process in left:
        _told(process, signal.SIGKILL)


def _told(process: BaseProcess, number: signal.Signals) -> bool:
    """Whether anybody of its group was there to be told."""
    if process.pid is None:
        return False
    try:
        os.killpg(process.pid, number)
    except ProcessLookupError:  # all are gone, or it has not signed on
        if not process.is_alive():
            return False
        with contextlib.suppress(ProcessLookupError):
            os.kill(process.pid, number)
    return True
