"""Whether somebody attends: what begins no flight, what is told once, what ends a flight, and what changes nothing."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from uav_recon.mission.requests.operator_watchdog import OperatorWatchdog
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

HZ = 30


WARNED = Reason(ReasonCode.OPERATOR_SILENT, (5.0, 30.0))
RETURNS = Reason(ReasonCode.OPERATOR_LOST_RETURNING, (30.0,))


def told(
    heard: Callable[[float], bool], seconds: float, timeout_s: float = 30.0
) -> tuple[list[tuple[float, Reason]], list[float]]:
    """What is known of a flight that begins at 100 s with an operator there, and when it had to go home; instants count from
    there. heard: whether there is a sign of life in that second.
    """
    one, received_s = OperatorWatchdog(timeout_s), 100.0
    one.update(100.0, received_s, flying=False)
    assert not one.missing
    news, lost = list[tuple[float, Reason]](), list[float]()
    for turn in range(1, int(seconds * HZ) + 1):
        now_s = 100.0 + turn / HZ
        if turn % HZ == 0 and heard(turn / HZ):
            received_s = now_s
        said = one.update(now_s, received_s, flying=True)
        if said:
            news.append((round(turn / HZ, 1), said))
        if one.lost:
            lost.append(turn / HZ)
    return news, lost


def test_a_flight_begins_only_while_somebody_attends() -> None:
    one = OperatorWatchdog(30.0)
    assert one.missing == Reason(ReasonCode.OPERATOR_MISSING), "before anything was heard at all"
    one.update(100.0, -math.inf, flying=False)
    assert one.missing
    waits = list[bool]()
    for now_s in (101.0, 105.8, 106.0):
        one.update(now_s, 100.9, flying=False)
        waits.append(bool(one.missing))
    assert waits == [False, False, True]
    assert (one.note, one.lost) == (None, None), "on the ground nobody is warned and nothing returns"
    one.update(900.0, 100.9, flying=False)
    assert one.lost is None


def test_one_silence_is_warned_of_once_and_ends_the_flight() -> None:
    news, lost = told(lambda s: s <= 10.0, 60.0)
    assert news == [(15.0, WARNED), (40.0, RETURNS)]
    assert lost[0] == pytest.approx(40.0, abs=0.1)
    assert lost[-1] == 60.0


def test_one_sign_in_ten_seconds_warns_once_and_never_counts_as_back() -> None:
    assert told(lambda s: s % 10 == 0, 300.0) == ([(5.0, WARNED)], [])


def test_who_was_missed_is_back_after_five_seconds_of_signs_and_may_be_missed_again() -> None:
    news, lost = told(lambda s: 20 <= s <= 40, 50.0)
    assert [at for at, _ in news] == [5.0, 25.0, 45.0]
    assert news[1][1] == Reason(ReasonCode.OPERATOR_BACK)
    assert not lost


def test_a_sign_ends_the_need_to_return_but_is_not_told_as_a_new_silence() -> None:
    news, lost = told(lambda s: s == 35, 60.0)
    assert [text for _, text in news] == [WARNED, RETURNS]
    assert 30.0 < lost[0] < lost[-1] < 35.0


def test_signs_under_five_seconds_apart_are_no_silence() -> None:
    assert told(lambda s: s % 4 == 0, 120.0) == ([], [])


def test_where_nobody_need_attend_nothing_is_missed() -> None:
    one = OperatorWatchdog()
    for now_s, flying in ((100.0, False), (101.0, True), (5000.0, True)):
        assert one.update(now_s, -math.inf, flying) is None
        assert (one.missing, one.lost, one.note) == (None, None, None)


def test_a_pilot_that_has_forgotten_takes_nothing_away() -> None:
    one = OperatorWatchdog(30.0)
    one.update(100.0, 99.5, flying=True)
    one.update(104.0, -math.inf, flying=True)
    assert one.note is None
    fresh = OperatorWatchdog(30.0)
    fresh.update(100.0, -math.inf, flying=True)
    fresh.update(104.0, -math.inf, flying=True)
    assert (fresh.note, fresh.lost) == (None, None)
    fresh.update(131.0, -math.inf, flying=True)
    assert fresh.lost, "counted from when it was first looked at"


def test_a_sign_from_the_future_is_none() -> None:
    one = OperatorWatchdog(30.0)
    one.update(100.0, 99.5, flying=True)
    one.update(131.0, 1e9, flying=True)
    assert one.lost
