"""Injected time: a monotonic clock, a manual clock, a rate keeper and three executors."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from typing import Generic, TypeVar

from uav_recon.interfaces import Clock, Pending

T = TypeVar("T")


class MonotonicClock:
    """CLOCK_MONOTONIC, shared by all processes of one machine."""

    def now_s(self) -> float:
        """Return the time in seconds."""
        return time.monotonic()

    def sleep_until(self, instant_s: float) -> None:
        """Block until the instant."""
        delay_s = instant_s - time.monotonic()
        if delay_s > 0:
            time.sleep(delay_s)


class ManualClock:
    """A clock that is advanced by its owner, for lockstep and tests."""

    def __init__(self, start_s: float = 0.0) -> None:
        self._now_s = start_s

    def now_s(self) -> float:
        """Return the time in seconds."""
        return self._now_s

    def sleep_until(self, instant_s: float) -> None:
        """Return at once, because only advance_to() moves this clock."""

    def advance_to(self, instant_s: float) -> None:
        """Advance the clock. Raises ValueError if the instant is in the past."""
        if instant_s < self._now_s:
            raise ValueError(f"clock would go back from {self._now_s} s to {instant_s} s")
        self._now_s = instant_s


class RateKeeper:
    """Schedules a periodic job without drift. A late job runs once; missed periods are skipped."""

    def __init__(self, rate_hz: float, start_s: float) -> None:
        self.period_s = 1.0 / rate_hz
        self._origin_s = start_s
        self._next = 0

    def next_s(self) -> float:
        """Return the instant at which the job is due next, in seconds."""
        return self._origin_s + self._next * self.period_s

    def due(self, now_s: float) -> bool:
        """Return True once per period."""
        if now_s + 1e-9 < self.next_s():
            return False
        self._next = max(self._next + 1, int((now_s - self._origin_s) / self.period_s + 1e-6) + 1)
        return True


class _Finished(Generic[T]):
    """A result that becomes visible at an instant of the simulated clock."""

    def __init__(self, clock: Clock, value: T, visible_s: float) -> None:
        self._clock = clock
        self._value = value
        self._visible_s = visible_s

    def done(self) -> bool:
        return self._clock.now_s() >= self._visible_s

    def result(self) -> T:
        return self._value


class InlineExecutor:
    """Executor for lockstep. Work runs at once; its result is visible after its declared cost."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    def submit(self, work: Callable[[], T], cost_s: float) -> Pending[T]:
        """Run the work now; its result becomes visible after ``cost_s`` simulated seconds."""
        value = work()
        return _Finished(self._clock, value, self._clock.now_s() + cost_s)

    def close(self) -> None:
        """Do nothing: no work is ever pending."""


class ThreadExecutor:
    """Executor for real time with one worker thread, so that plans never overlap.

    close_timeout_s: seconds for which close() waits for running work; None waits until it has returned. Work that never returns
        is abandoned and ends with the process.
    """

    def __init__(self, name: str, close_timeout_s: float | None = None) -> None:
        self._patience_s = close_timeout_s
        self._work: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def submit(self, work: Callable[[], T], cost_s: float) -> Pending[T]:
        """Start the work on the thread."""
        future: Future[T] = Future()
        self._work.put(lambda: self._do(work, future))
        return future

    def close(self) -> None:
        """Wait for running work and end. Work that has not started is cancelled."""
        self._closed = True
        self._work.put(None)
        self._thread.join(self._patience_s)

    def _run(self) -> None:
        while (work := self._work.get()) is not None:
            work()

    def _do(self, work: Callable[[], T], future: Future[T]) -> None:
        if self._closed:
            future.cancel()
        if not future.set_running_or_notify_cancel():
            return
        try:
            future.set_result(work())
        except BaseException as error:  # re-raised by result()
            future.set_exception(error)


class DetachedExecutor:
    """Executor for work that may never return.

    Each piece of work has a daemon thread, which ends with it. close() waits for nothing.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def submit(self, work: Callable[[], T], cost_s: float) -> Pending[T]:
        """Start the work on a thread of its own."""
        future: Future[T] = Future()

        def run() -> None:
            try:
                future.set_result(work())
            except BaseException as error:  # re-raised by result()
                future.set_exception(error)

        threading.Thread(target=run, name=self._name, daemon=True).start()
        return future

    def close(self) -> None:
        """Return at once: abandoned work ends with the process."""
