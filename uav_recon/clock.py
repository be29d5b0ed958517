"""Time, injected: a monotonic clock, a manual one, a rate keeper, and executors for both worlds."""

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
    """CLOCK_MONOTONIC: shared by all processes of one machine."""

    def now_s(self) -> float:
        """Seconds."""
        return time.monotonic()

    def sleep_until(self, instant_s: float) -> None:
        """Block until the instant."""
        delay_s = instant_s - time.monotonic()
        if delay_s > 0:
            time.sleep(delay_s)


class ManualClock:
    """A clock that its owner moves: lockstep and tests."""

    def __init__(self, start_s: float = 0.0) -> None:
        self._now_s = start_s

    def now_s(self) -> float:
        """Seconds."""
        return self._now_s

    def sleep_until(self, instant_s: float) -> None:
        """Return at once: only advance_to() moves this clock."""

    def advance_to(self, instant_s: float) -> None:
        """Move forward. Raises ValueError on a step back."""
        if instant_s < self._now_s:
            raise ValueError(f"clock would go back from {self._now_s} s to {instant_s} s")
        self._now_s = instant_s


class RateKeeper:
    """Says when a periodic job is due, without drift; a late job is done once, not caught up."""

    def __init__(self, rate_hz: float, start_s: float) -> None:
        self.period_s = 1.0 / rate_hz
        self._origin_s = start_s
        self._next = 0

    def next_s(self) -> float:
        """The instant at which the job is due next."""
        return self._origin_s + self._next * self.period_s

    def due(self, now_s: float) -> bool:
        """True once per period."""
        if now_s + 1e-9 < self.next_s():
            return False
        self._next = max(self._next + 1, int((now_s - self._origin_s) / self.period_s + 1e-6) + 1)
        return True


class _Finished(Generic[T]):
    """A result that becomes visible at an instant of the simulated clock."""

    def __init__(self, clock: Clock, value: T, visible_s: float) -> None:
        self._clock, self._value, self._visible_s = clock, value, visible_s

    def done(self) -> bool:
        return self._clock.now_s() >= self._visible_s

    def result(self) -> T:
        return self._value


class InlineExecutor:
    """Lockstep: work runs inline at once, its result is seen after its declared cost in simulated time."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    def submit(self, work: Callable[[], T], cost_s: float) -> Pending[T]:
        """Run now, show later."""
        value = work()
        return _Finished(self._clock, value, self._clock.now_s() + cost_s)

    def close(self) -> None:
        """Nothing runs here."""


class ThreadExecutor:
    """Real time: one worker thread, so plans never overlap. patience_s: how long close() waits for the work that runs; None:
    until it has returned. Work that never does is left behind, and ends with the process.
    """

    def __init__(self, name: str, patience_s: float | None = None) -> None:
        self._patience_s = patience_s
        self._work: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def submit(self, work: Callable[[], T], cost_s: float) -> Pending[T]:
        """Start work on the thread."""
        future: Future[T] = Future()
        self._work.put(lambda: self._do(work, future))
        return future

    def close(self) -> None:
        """Wait for running work and end; what has not begun is cancelled."""
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
        except BaseException as error:  # whoever asks for the result gets it
            future.set_exception(error)
