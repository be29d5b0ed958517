"""Restart of a device session beside the control loop.

Bounded waits, a limited number of attempts.

A driver may block for ever when a device was unplugged. Each blocking call therefore runs on a thread of its own, which is
abandoned when its time is over; what it still returns is closed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from uav_recon.interfaces import Executor, Pending

MAX_RESTARTS = 3  #: hold: a camera that is lost is opened again so often; then depth is missing, and the failsafe acts (C2)
_CLOSE_S = 1.0  #: internal: wait for the old session to end, before a new one is opened
_OPEN_S = 8.0  #: internal: wait for a session to open, before the next attempt
_PAUSE_S = 2.0  #: internal: pause before another attempt: a device that was plugged in again needs as long
_GOOD_S = 60.0  #: internal: restarts are counted from zero again after the camera has worked for this time


class Closeable(Protocol):
    """A session that can be closed."""

    def close(self) -> None:
        """End it. It may block."""
        ...


S = TypeVar("S", bound=Closeable)


class SessionRecovery(Generic[S]):
    """Opens a session again after it was lost.

    reopen: opens a session on a thread of its own, given the number of the attempt; it raises an exception of the type failure
    if it cannot. executor: starts each call at once, on a thread of its own. No call here blocks. ``attempts``: since the last
    good time. ``failure``: why the newest attempt failed, '' for none.
    """

    def __init__(
        self,
        reopen: Callable[[int], S],
        executor: Executor,
        failure: type[Exception],
        max_restarts: int = MAX_RESTARTS,
    ) -> None:
        self._reopen = reopen
        self._executor = executor
        self._failure = failure
        self._max_restarts = max_restarts
        self.attempts = 0
        self.failure = ""
        self._closing: Pending[None] | None = None
        self._opening: _Opening[S] | None = None
        self._until_s = -math.inf  # end of the wait for the present step
        self._opened_s = -math.inf

    @property
    def exhausted(self) -> bool:
        """True if the last attempt has failed."""
        return self.attempts >= self._max_restarts and self._opening is None and self._closing is None

    def begin(self, lost: S | None, now_s: float) -> None:
        """Close the lost session and begin an attempt, if one is left."""
        if now_s - self._opened_s > _GOOD_S and math.isfinite(self._opened_s):
            self.attempts = 0
        if lost is not None:
            self._closing = self._executor.submit(lost.close, 0.0)
            self._until_s = now_s + _CLOSE_S

    def step(self, now_s: float) -> S | None:
        """Return the new session once it is open, None before."""
        if self._closing is not None:
            if not self._closing.done() and now_s < self._until_s:
                return None
            self._closing, self._until_s = None, now_s
        if self._opening is None:
            if self.attempts < self._max_restarts and now_s >= self._until_s:
                self.attempts += 1
                self._opening = _Opening(self._reopen, self.attempts, self._failure)
                self._opening.start(self._executor)
                self._until_s = now_s + _OPEN_S
            if self._opening is None:
                return None
        return self._result(self._opening, now_s)

    def _result(self, opening: _Opening[S], now_s: float) -> S | None:
        if not opening.done():
            if now_s >= self._until_s:
                opening.abandon()
                self._fail(f"no answer within {_OPEN_S:.0f} s", now_s)
            return None
        session = opening.result()
        if session is None:
            self._fail(opening.failure, now_s)
            return None
        self._opening, self.failure, self._opened_s = None, "", now_s
        return session

    def _fail(self, failure: str, now_s: float) -> None:
        self._opening, self.failure, self._until_s = None, failure, now_s + _PAUSE_S


class _Opening(Generic[S]):
    """One attempt; what it returns after it was abandoned is closed."""

    def __init__(self, reopen: Callable[[int], S], attempt: int, failure: type[Exception]) -> None:
        self.session: S | None = None
        self.failure = ""
        self._reopen = reopen
        self._attempt = attempt
        self._failure = failure
        self._abandoned = False
        self._pending: Pending[None] | None = None

    def start(self, executor: Executor) -> None:
        self._pending = executor.submit(self._run, 0.0)

    def done(self) -> bool:
        return self._pending is not None and self._pending.done()

    def result(self) -> S | None:
        """Return the session, None for a failure. Raises what is no failure of the device: a bug."""
        assert self._pending is not None
        self._pending.result()
        return self.session

    def abandon(self) -> None:
        self._abandoned = True

    def _run(self) -> None:
        try:
            session = self._reopen(self._attempt)
        except self._failure as error:
            self.failure = str(error)
            return
        if self._abandoned:
            session.close()
        else:
            self.session = session
