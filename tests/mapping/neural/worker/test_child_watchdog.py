"""Watchdog of the mapper process.

It distinguishes a hung child from one that works, starves or waits for a disk.
"""

from __future__ import annotations

import os

from uav_recon.mapping.neural.worker.child_watchdog import (
    CHECK_PERIOD_S,
    IDLE_TIMEOUT_S,
    RESPONSE_TIMEOUT_S,
    ChildWatchdog,
    ProcessActivity,
    activity_of,
)


def given_up_after_s(
    activity: ProcessActivity, grows: bool = False, patient: bool = False, longest_s: float = 200.0
) -> float | None:
    """Return the seconds from a request until the child is given up; None for never."""
    watchdog, now_s = ChildWatchdog(), 0.0
    watchdog.asked(now_s)
    while now_s < longest_s:
        now_s += CHECK_PERIOD_S
        used_s = activity.processor_s + (now_s if grows else 0.0)
        if watchdog.is_hung(now_s, ProcessActivity(used_s, activity.at_rest), patient):
            return now_s
    return None


def test_a_sleeping_child_with_a_pending_request_is_given_up_soon() -> None:
    after_s = given_up_after_s(ProcessActivity(7.0, at_rest=True))
    assert after_s is not None
    assert IDLE_TIMEOUT_S < after_s <= IDLE_TIMEOUT_S + 2 * CHECK_PERIOD_S


def test_a_computing_or_starving_child_has_a_minute() -> None:
    for working in (
        given_up_after_s(ProcessActivity(7.0, at_rest=True), grows=True),
        given_up_after_s(ProcessActivity(7.0, at_rest=False)),
    ):
        assert working is not None
        assert RESPONSE_TIMEOUT_S < working <= RESPONSE_TIMEOUT_S + CHECK_PERIOD_S


def test_a_compiling_child_is_waited_for_unless_it_sleeps() -> None:
    assert given_up_after_s(ProcessActivity(7.0, at_rest=False), patient=True) is None
    assert given_up_after_s(ProcessActivity(7.0, at_rest=True), patient=True) is not None


def test_a_child_without_a_pending_request_may_sleep() -> None:
    watchdog = ChildWatchdog()
    assert not watchdog.is_hung(100.0, ProcessActivity(1.0, at_rest=True), patient=False)
    watchdog.asked(100.0)
    watchdog.answered()
    assert not watchdog.is_hung(300.0, ProcessActivity(1.0, at_rest=True), patient=False)


def test_an_ended_process_is_not_reported_as_hung() -> None:
    watchdog = ChildWatchdog()
    watchdog.asked(0.0)
    assert not watchdog.is_hung(1000.0, None, patient=False)
    assert activity_of(2**22 + 1) is None


def test_the_activity_of_this_process_is_read() -> None:
    activity = activity_of(os.getpid())
    assert activity is not None
    assert activity.processor_s > 0.0
    assert not activity.at_rest
