"""The way back along breadcrumbs: where it leads, and that the guard's limits hold on it."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from uav_recon.autopilot.retreat import Breadcrumbs
from uav_recon.autopilot.soundness import fault_of
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
    assert fault_of(way) == ""
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
    assert fault_of(way) == ""
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
