"""Restart of a device session: bounded waits, three attempts, and nothing that is left open."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from uav_recon.clock import InlineExecutor, ManualClock
from uav_recon.sensors.session_recovery import MAX_RESTARTS, SessionRecovery


class _Session:
    def __init__(self) -> None:
        self.closed = False

    def close(self) -> None:
        self.closed = True


class _Device:
    """A device that answers, refuses or hangs; hung work is ended later by finish()."""

    def __init__(self, *answers: str) -> None:
        self.clock = ManualClock(10.0)
        self.answers = list(answers)
        self.sessions: list[_Session] = []
        self.hung: list[Callable[[], Any]] = []
        self.recovery = SessionRecovery[_Session](self._reopen, self, OSError)

    def _reopen(self, attempt: int) -> _Session:
        if self.answers and self.answers[min(attempt, len(self.answers)) - 1] == "refuses":
            raise OSError(f"attempt {attempt}")
        self.sessions.append(_Session())
        return self.sessions[-1]

    def submit(self, work: Callable[[], Any], cost_s: float) -> Any:
        if self.answers and self.answers[min(self.recovery.attempts, len(self.answers)) - 1] == "hangs":
            self.hung.append(work)
            return _Never()
        return InlineExecutor(self.clock).submit(work, cost_s)

    def close(self) -> None:
        raise AssertionError

    def run(self, seconds: float) -> _Session | None:
        """Step at 100 Hz until a session is open."""
        for _ in range(round(100 * seconds)):
            self.clock.advance_to(self.clock.now_s() + 0.01)
            session = self.recovery.step(self.clock.now_s())
            if session is not None:
                return session
        return None


class _Never:
    def done(self) -> bool:
        return False

    def result(self) -> Any:
        raise AssertionError


def test_the_lost_session_is_closed_and_another_one_opened() -> None:
    device, lost = _Device("answers"), _Session()
    device.recovery.begin(lost, device.clock.now_s())
    assert device.run(0.1) is device.sessions[0]
    assert lost.closed
    assert not device.sessions[0].closed
    assert device.recovery.attempts == 1


def test_after_three_refusals_nothing_more_is_tried() -> None:
    device = _Device("refuses")
    device.recovery.begin(_Session(), device.clock.now_s())
    assert device.run(60.0) is None
    assert device.recovery.exhausted
    assert device.recovery.attempts == MAX_RESTARTS == 3
    assert device.recovery.failure == "attempt 3"


def test_a_call_that_hangs_is_abandoned_and_what_it_still_opens_is_closed() -> None:
    device = _Device("hangs", "answers")
    device.recovery.attempts = 0
    device.recovery.begin(None, device.clock.now_s())
    assert device.run(9.9) is None
    session = device.run(0.5)
    assert session is device.sessions[0]
    device.hung[0]()  # the first call returns at last
    assert device.sessions[1].closed
    assert not device.sessions[0].closed


def test_restarts_are_counted_again_after_a_minute_of_work() -> None:
    device = _Device("answers")
    for worked_s, attempts in ((10.0, 1), (10.0, 2), (61.0, 1)):
        device.clock.advance_to(device.clock.now_s() + worked_s)
        device.recovery.begin(_Session(), device.clock.now_s())
        device.run(0.1)
        assert device.recovery.attempts == attempts


def test_a_bug_is_raised_and_not_taken_for_a_lost_device() -> None:
    class _Broken(InlineExecutor):
        def submit(self, work: Callable[[], Any], cost_s: float) -> Any:
            return _Raised()

    class _Raised:
        def done(self) -> bool:
            return True

        def result(self) -> Any:
            raise ZeroDivisionError

    recovery = SessionRecovery[_Session](lambda attempt: _Session(), _Broken(ManualClock()), OSError)
    recovery.begin(None, 0.0)
    with pytest.raises(ZeroDivisionError):
        recovery.step(0.0)
