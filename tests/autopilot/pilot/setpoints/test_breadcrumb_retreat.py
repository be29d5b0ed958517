"""The way back along breadcrumbs: where it leads, and that the guard's limits hold on it."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

import numpy as np
import pytest

from uav_recon.autopilot.pilot.setpoints.breadcrumb_retreat import Breadcrumbs
from uav_recon.autopilot.pilot.situation.message_validation import trajectory_fault
from uav_recon.config import SafetyConfig
from uav_recon.types.pose import Pose
from uav_recon.types.trajectory import Setpoint, Trajectory


def flown(*corners: tuple[float, float, float]) -> Breadcrumbs:
    crumbs = Breadcrumbs()
    for a, b in itertools.pairwise(corners):
        for share in np.linspace(0.0, 1.0, 100):
            crumbs.drop(Pose.from_yaw(0.0, np.array(a) + share * (np.array(b) - np.array(a))))
    return crumbs


def back(crumbs: Breadcrumbs, end: tuple[float, float, float], nose_first: bool = True) -> Trajectory:
    return crumbs.way_back(Setpoint.hold(np.array(end), 0.0), 1.0, 50.0, 0.3, 0, nose_first)


OUT = ((0.0, 0.0, 0.0), (0.0, 0.0, 1.1), (3.0, 0.0, 1.1), (3.0, 2.0, 1.1))


def test_it_leads_back_over_the_pad_within_the_limits() -> None:
    way = back(flown(*OUT), OUT[-1])
    assert trajectory_fault(way) is None
    np.testing.assert_allclose(way.position_m[0], OUT[-1])
    assert np.hypot(*way.position_m[-1][:2]) < 0.25
    assert way.position_m[:, 2].min() >= 1.0
    assert np.linalg.norm(way.velocity_mps, axis=1).max() <= 0.3
    assert np.linalg.norm(way.acceleration_mps2, axis=1).max() <= 1.0
    assert np.abs(way.yaw_rate_radps).max() <= 0.7 + 1e-6
    assert np.linalg.norm(np.diff(way.position_m, axis=0), axis=1).max() <= 0.3 * way.step_s
    legs = np.array([[3.0, 2.0], [3.0, 0.0], [0.0, 0.0]])
    for x, y in way.position_m[:, :2]:
        assert min(abs(x - legs[1][0]) if y > 0.1 else 9.0, abs(y)) < 0.15, "where it has been"


def test_it_goes_nose_first_if_there_is_depth_to_see_with() -> None:
    way = back(flown(*OUT), OUT[-1])
    moving = np.linalg.norm(way.velocity_mps, axis=1) > 0.25
    bearing = np.arctan2(way.velocity_mps[:, 1], way.velocity_mps[:, 0])
    off = np.abs(np.angle(np.exp(1j * (way.yaw_rad - bearing))))[moving]
    assert np.median(off) < 0.1
    assert np.ptp(back(flown(*OUT), OUT[-1], nose_first=False).yaw_rad) == 0.0


def test_loops_are_cut_out() -> None:
    loop = ((0.0, 0.0, 1.1), (2.0, 0.0, 1.1), (2.0, 2.0, 1.1), (2.0, 0.0, 1.1), (3.0, 0.0, 1.1))
    assert back(flown(*loop), loop[-1]).position_m[:, 1].max() < 0.3


@pytest.mark.parametrize("crumbs", [Breadcrumbs(), flown((0.0, 0.0, 0.0), (0.0, 0.0, 0.5))])
def test_without_breadcrumbs_it_stays(crumbs: Breadcrumbs) -> None:
    way = back(crumbs, (1.0, 1.0, 1.1))
    assert trajectory_fault(way) is None
    assert np.ptp(way.position_m, axis=0).max() < 1e-9


def test_in_another_odom_they_are_forgotten() -> None:
    crumbs = flown(*OUT)
    crumbs.forget()
    assert np.ptp(back(crumbs, OUT[-1]).position_m, axis=0).max() < 1e-9


@pytest.mark.parametrize("nose_first", [True, False])
def test_it_begins_at_once_and_slower_while_it_turns(nose_first: bool) -> None:
    crumbs = flown((0.0, 0.0, 1.1), (3.0, 0.0, 1.1))
    way = back(crumbs, (3.0, 0.0, 1.1), nose_first)
    speed = np.linalg.norm(way.velocity_mps, axis=1)
    assert np.argmax(speed > 0.05) * way.step_s <= 0.4
    off = np.abs(np.angle(np.exp(1j * (way.yaw_rad - np.pi))))
    if nose_first:
        assert speed[off > 0.5].max() <= 0.14
    assert speed.max() > 0.26


def lines_run(work: Callable[[], object]) -> int:
    """How many lines of Python a piece of work runs, a loop's each time: what it costs, on any machine."""
    count, before = 0, sys.gettrace()

    def line(frame: FrameType, event: str, argument: Any) -> Any:
        nonlocal count
        count += event == "line"
        return line

    sys.settrace(line)
    try:
        work()
    finally:
        sys.settrace(before)
    return count


def serpentine(most: int) -> list[tuple[float, float, float]]:
    """Breadcrumbs between shelves of 30 m, 1.5 m apart: no loop that could be cut out."""
    places = []
    for n in range(most):
        lap, along = divmod(n, 150)
        x_m = 0.21 * min(along, 143)
        places.append((x_m if lap % 2 == 0 else 30.03 - x_m, 1.5 * lap + 0.21 * max(along - 143, 0), 1.1))
    return places


def dropped(places: list[tuple[float, float, float]]) -> Breadcrumbs:
    crumbs = Breadcrumbs()
    for place in places:
        crumbs.drop(Pose.from_yaw(0.0, np.array(place)))
    return crumbs


def test_a_retreat_begins_as_quickly_after_a_long_flight_as_after_a_short_one() -> None:
    costs = []
    for n in (140, 1040, 4940, 12140):
        places = serpentine(n)
        crumbs = dropped(places)
        costs.append(lines_run(lambda crumbs=crumbs, end=places[-1]: back(crumbs, end)))  # type: ignore[misc]
    assert costs[0] < 15_000
    assert max(costs) < 1.2 * costs[0], "lines of Python until the way is there"


def test_as_far_as_can_be_flown_before_it_lands_it_is_the_whole_way() -> None:
    """A retreat ends in a landing after land_timeout_s: what lies beyond that much flight is not worked out."""
    max_s = max(getattr(limit, "le", 0.0) for limit in SafetyConfig.model_fields["land_timeout_s"].metadata)
    places = serpentine(600)
    way = back(dropped(places), places[-1])
    assert trajectory_fault(way) is None
    assert way.duration_s >= max_s
    flown_m = np.linalg.norm(np.diff(way.position_m, axis=0), axis=1).sum()
    assert flown_m == pytest.approx(0.9 * 0.3 * max_s, abs=0.3), "a little below the speed that is allowed"
    off_m = [np.linalg.norm(np.array(places) - place, axis=1).min() for place in way.position_m]
    assert max(off_m) < 0.15
    np.testing.assert_allclose(way.velocity_mps[-1], 0.0)


@pytest.mark.nightly
def test_after_a_kilometre_the_newest_breadcrumbs_lead_back() -> None:
    places = serpentine(6000)
    way = back(dropped(places), places[-1])
    off_m = [np.linalg.norm(np.array(places) - place, axis=1).min() for place in way.position_m]
    assert max(off_m) < 0.15, "where it has been, and not straight to where it was a kilometre ago"
