"""When a ground station is told that the speed is reduced, and that it is full again."""

from __future__ import annotations

import itertools
from collections.abc import Callable

from uav_recon.autopilot.pilot.reports.reduced_speed_reporter import ReducedSpeedReporter
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

NO_IMU = Reason(ReasonCode.NO_IMU)


def told(cause: Callable[[float], Reason | None], seconds: float = 60.0) -> list[tuple[float, tuple[str, ...]]]:
    """Return time and codes of the messages for the cause at each time, from 10 s on."""
    reporter = ReducedSpeedReporter()
    found = []
    for turn in range(round(100 * seconds)):
        message = reporter.update(cause(turn / 100), 10.0 + turn / 100)
        if message is not None:
            found.append((turn / 100, message.codes()))
    return found


def test_full_speed_needs_no_message() -> None:
    assert told(lambda _: None) == []


def test_one_late_pose_is_no_message() -> None:
    assert told(lambda t: Reason(ReasonCode.NO_POSE, (0.2,)) if 5.0 <= t < 5.1 else None) == []


def test_a_cause_that_lasts_is_told_once_whatever_its_values() -> None:
    found = told(lambda t: Reason(ReasonCode.FEW_POSES, (5.0 + t % 3,)) if t >= 5.0 else None)
    assert found == [(5.3, ("reduced-speed", "few-poses"))]


def test_its_end_is_told_after_two_seconds_without_it() -> None:
    found = told(lambda t: NO_IMU if 5.0 <= t < 20.0 else None)
    assert [codes for _, codes in found] == [("reduced-speed", "no-imu"), ("full-speed",)]
    assert 21.9 < found[1][0] < 22.1


def test_a_cause_that_comes_and_goes_is_told_once() -> None:
    """It is there for a quarter of a second in each second: less than one late pose at a time, and a slow flight."""
    found = told(lambda t: NO_IMU if t >= 5.0 and t % 1.0 < 0.25 else None)
    assert [codes for _, codes in found] == [("reduced-speed", "no-imu")]
    assert found[0][0] <= 6.0


def test_another_cause_is_told_a_second_later() -> None:
    found = told(lambda t: NO_IMU if t >= 5.5 else Reason(ReasonCode.FEW_POSES, (7.0,)) if t >= 5.0 else None)
    assert found == [(5.3, ("reduced-speed", "few-poses")), (6.3, ("reduced-speed", "no-imu"))]


def test_causes_that_alternate_are_told_once_in_ten_seconds() -> None:
    found = told(lambda t: NO_IMU if int(t) % 2 else Reason(ReasonCode.FEW_POSES, (7.0,)))
    for cause in ("no-imu", "few-poses"):
        times_s = [at_s for at_s, codes in found if cause in codes]
        assert len(times_s) in (5, 6)
        assert min(b - a for a, b in itertools.pairwise(times_s)) >= 10.0 - 1e-6
