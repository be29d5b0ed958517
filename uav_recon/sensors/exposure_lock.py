"""Lock of the colour camera's exposure and white balance before take-off.

Colours that change in flight become texture. Until the motors are about to start both are automatic, because light on the
ground changes; then they keep the values that have settled. The controls of a device may block, so they are set beside the
control loop. The infrared imagers stay automatic: a depth image that is too dark or too bright has no returns.
"""

from __future__ import annotations

import math
from enum import Enum, auto
from typing import Protocol

from uav_recon.interfaces import Executor, Pending
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_SETTLE_S = 2.0  #: warn: exposure that was automatic for a shorter time before take-off is not locked
_CHECK_S = 0.5  #: internal: time from the lock to the check of the image
_ANSWER_S = 3.0  #: warn: controls that are not set within this time
#: warn: exposure is automatic again if the mean brightness changes by more than this ratio at the lock
_CHANGE_FACTOR = 1.3
_OVER_S = 5.0  #: internal: exposure is automatic again after the vehicle has stood for this time


class ExposureControls(Protocol):
    """The controls of a colour camera. Each call may block for seconds.

    Each raises the device's error (one line) if it fails.
    """

    def lock(self) -> tuple[float, float]:
        """Keep the present values.

        Returns exposure (as the device counts it) and white balance (K, NaN if unknown).
        """
        ...

    def release(self) -> None:
        """Make both automatic again."""
        ...


class _State(Enum):
    AUTOMATIC = auto()
    LOCKING = auto()
    CHECKING = auto()
    LOCKED = auto()
    FAILED = auto()


class ExposureLock:
    """Locks when the flight is near, checks the image, and releases on the ground.

    No call blocks.

    executor: starts each blocking call at once. failure: type of the device's errors. ``reason``: None while automatic,
    otherwise that it is locked, or why not.
    """

    def __init__(self, controls: ExposureControls, executor: Executor, failure: type[Exception], now_s: float) -> None:
        self._controls = controls
        self._executor = executor
        self._failure = failure
        self._since_s = now_s  # since when it is automatic
        self._state = _State.AUTOMATIC
        self._pending: Pending[tuple[float, float] | str] | None = None
        self._until_s = math.inf
        self._before = math.nan
        self._near_s = -math.inf
        self._fresh = True
        self.reason: Reason | None = None

    def step(self, now_s: float, near_flight: bool, brightness: float) -> None:
        """Take the next step; brightness: mean of the newest image, positive."""
        if near_flight:
            self._near_s = now_s
        if self._state is _State.AUTOMATIC:
            self._begin(now_s, near_flight, brightness)
        elif self._state is _State.LOCKING:
            self._await(now_s)
        elif self._state is _State.CHECKING and now_s >= self._until_s:
            self._check(brightness)
        elif self._state in (_State.LOCKED, _State.FAILED) and now_s - self._near_s > _OVER_S:
            self._release()
            self._state, self._since_s, self.reason = _State.AUTOMATIC, now_s, None

    def _begin(self, now_s: float, near_flight: bool, brightness: float) -> None:
        if not near_flight:
            if self._fresh:  # the flight of another process may have left it locked
                self._release()
            self._fresh = False
            return
        if now_s - self._since_s < _SETTLE_S:
            self._fail("it had no time to settle before take-off")
            return
        self._before, self._until_s = brightness, now_s + _ANSWER_S
        self._pending = self._executor.submit(self._locked, 0.0)
        self._state = _State.LOCKING

    def _locked(self) -> tuple[float, float] | str:
        """Lock; returns the values, or why not. It may block."""
        try:
            return self._controls.lock()
        except self._failure as error:
            return str(error)

    def _await(self, now_s: float) -> None:
        if self._pending is None or not self._pending.done():
            if now_s >= self._until_s:
                self._fail(f"no answer within {_ANSWER_S:.0f} s")
            return
        answer = self._pending.result()
        if isinstance(answer, str):
            self._fail(answer)
            return
        self._state, self._until_s = _State.CHECKING, now_s + _CHECK_S
        self.reason = Reason(ReasonCode.EXPOSURE_LOCKED, answer)

    def _check(self, brightness: float) -> None:
        """Compare the images before and after: some devices fall back to another exposure."""
        change = brightness / self._before if self._before > 0.0 else math.inf
        if 1.0 / _CHANGE_FACTOR <= change <= _CHANGE_FACTOR:
            self._state = _State.LOCKED
            return
        self._release()
        self._fail(f"the brightness changed by {change:.2f} at the lock")

    def _release(self) -> None:
        def released() -> str:
            try:
                self._controls.release()
            except self._failure as error:
                return str(error)
            return ""

        self._executor.submit(released, 0.0)

    def _fail(self, why: str) -> None:
        self._state, self.reason = _State.FAILED, Reason(ReasonCode.EXPOSURE_NOT_LOCKED, (why,))
