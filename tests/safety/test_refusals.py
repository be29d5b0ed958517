"""The counter of refusals, and what a flight concludes from it: many at once, and nothing else for a long time."""

from __future__ import annotations

import pytest

from uav_recon.safety.refusals import RefusalCounter, RefusalHistory

TICK_S = 1 / 30


def history_of(counter: RefusalCounter) -> RefusalHistory:
    return RefusalHistory(counter, quiet_s=20.0)


def run(history: RefusalHistory, seconds: float, now_s: float, moving: bool = False) -> float:
    """Update for a while; return the instant at which it ends."""
    for _ in range(round(seconds / TICK_S)):
        now_s += TICK_S
        history.update(moving, now_s)
    return now_s


def refuse(counter: RefusalCounter, times: int = 1) -> None:
    for _ in range(times):
        counter.add()


@pytest.mark.parametrize("period_s", [0.5, 3.0, 19.0])
def test_the_duration_is_from_the_first_refusal_to_the_last(period_s: float) -> None:
    counter, now_s = RefusalCounter(), 100.0
    history = history_of(counter)
    assert history.refused_s == 0.0
    for n in range(5):
        counter.add()
        now_s = run(history, period_s, now_s)
        assert history.refused_s == pytest.approx(n * period_s, abs=0.1)
    assert counter.total == 5


def test_hovering_after_a_refusal_is_not_being_refused() -> None:
    counter = RefusalCounter()
    history = history_of(counter)
    counter.add()
    now_s = run(history, 21.0, 100.0)
    assert history.refused_s == 0.0
    counter.add()
    run(history, 3.0, now_s)
    assert history.refused_s == 0.0, "the one before is too long ago"


def test_refusals_farther_apart_than_the_limit_do_not_belong_together() -> None:
    for apart_s, refused_s in ((20.0, 20.0), (20.01, 0.0)):
        counter = RefusalCounter()
        history = history_of(counter)
        counter.add()
        history.update(False, 0.0)
        counter.add()
        history.update(False, apart_s)
        assert history.refused_s == refused_s


def test_a_motion_of_a_second_ends_the_duration_and_a_shorter_one_does_not() -> None:
    for motion_s, refused_s in ((0.99, 3.0), (1.0, 0.0)):
        counter = RefusalCounter()
        history = history_of(counter)
        for now_s in (0.0, 1.0):
            counter.add()
            history.update(False, now_s)
        assert history.refused_s == 1.0
        history.update(True, 1.5)
        history.update(True, 1.5 + motion_s)
        counter.add()
        history.update(False, 3.0)
        assert history.refused_s == refused_s


def test_a_motion_that_goes_on_for_longer_than_a_second_ends_the_duration_too() -> None:
    counter = RefusalCounter()
    history = history_of(counter)
    for now_s in (0.0, 1.0):
        counter.add()
        history.update(False, now_s)
    for now_s in (1.5, 2.2, 2.9):
        history.update(True, now_s)
    counter.add()
    history.update(False, 3.0)
    assert history.refused_s == 0.0


def test_two_moments_of_motion_are_no_motion() -> None:
    counter = RefusalCounter()
    history, now_s = history_of(counter), 100.0
    for _ in range(7):
        counter.add()
        now_s = run(history, 0.1, run(history, 0.8, now_s, moving=True))
    assert history.refused_s == pytest.approx(5.4, abs=0.1)


def test_refusals_before_the_flight_do_not_count() -> None:
    counter = RefusalCounter()
    refuse(counter, 40)
    history = history_of(counter)
    assert not history.many(0.0)
    history.update(False, 0.0)
    history.update(False, 2.0)
    assert history.refused_s == 0.0
    for now_s in (3.0, 4.5):
        counter.add()
        history.update(False, now_s)
    assert history.refused_s == 1.5
    assert history_of(counter).refused_s == 0.0


def test_three_refusals_in_a_second_are_many_for_two() -> None:
    counter = RefusalCounter()
    history = history_of(counter)
    assert not history.many(0.0)
    for now_s, many in ((0.1, False), (0.2, False), (1.1, True)):
        counter.add()
        assert history.many(now_s) is many
    assert history.many(2.1)
    assert not history.many(2.2)


def test_three_refusals_in_more_than_a_second_are_not_many() -> None:
    counter = RefusalCounter()
    history = history_of(counter)
    for now_s in (0.0, 0.6, 1.01, 1.7, 2.3):
        counter.add()
        assert not history.many(now_s)


def test_refusals_of_one_step_count_once() -> None:
    counter = RefusalCounter()
    history = history_of(counter)
    refuse(counter, 3)
    assert not history.many(0.0)
    refuse(counter, 3)
    assert not history.many(0.1)
    refuse(counter, 3)
    assert history.many(0.2)


def test_a_step_without_a_refusal_adds_nothing() -> None:
    counter = RefusalCounter()
    history = history_of(counter)
    counter.add()
    assert not any(history.many(0.1 * n) for n in range(30))
