"""What a tracker beside odom tells: a drift of odom, or errors of camera and tracker."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uav_recon.localization.correction.offset_filter import OFFSET, RATE, OffsetFilter
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

EVERY_S = 0.2


def _flown(stamp_s: float) -> Pose:
    """Return the true pose on a round of 4 m radius, which begins at the pad."""
    angle = 0.125 * max(stamp_s - 2.0, 0.0)
    return Pose.from_yaw(angle + math.pi / 2, 4.0 * np.array([math.cos(angle) - 1.0, math.sin(angle), 0.1 * math.sin(angle)]))


class Flight:
    """Odom that drifts, and a tracker with errors; both are exact on the pad."""

    def __init__(self, drift_mps: FloatArray, from_s: float = 20.0) -> None:
        self.filter: OffsetFilter | None = None
        self._drift_mps = drift_mps
        self._from_s = from_s
        self.most_surprising = 0.0

    def fly(
        self, until_s: float, scale: float = 0.0, turned: float = 0.0, step_m: float = 0.0, tilted: float = 0.0
    ) -> OffsetFilter:
        """Return the filter at the end.

        Errors of the tracker: depth scale, a map turned by an angle, a step after half of the time, and a tilt from then on.
        """
        noise = np.random.default_rng(1)
        for n in range(int(until_s / EVERY_S)):
            stamp_s = n * EVERY_S
            true = _flown(stamp_s)
            drift_m = self._drift_mps * max(stamp_s - self._from_s, 0.0)
            odom = Pose(true.quat_wxyz, true.translation_m + drift_m + noise.normal(0.0, 0.003, 3))
            late = stamp_s > until_s / 2
            map_turn = Pose.from_rotation_vector(
                np.array([0.0, tilted * late, turned]), step_m * late * np.array([1.0, 0.0, 0.0])
            )
            seen = map_turn @ Pose(true.quat_wxyz, (1.0 + scale) * true.translation_m)
            if self.filter is None:
                self.filter = OffsetFilter(odom, stamp_s)
            self.filter.update(odom, seen, np.eye(3), stamp_s)
            self.most_surprising = max(self.most_surprising, self.filter.surprise)
        assert self.filter is not None
        return self.filter


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("speed_mps", [0.02, 0.05, 0.2])
def test_a_drift_is_found_with_its_rate(axis: int, speed_mps: float) -> None:
    drift_mps = speed_mps * np.eye(3)[axis]
    flight = Flight(drift_mps)
    found = flight.fly(45.0)
    assert np.linalg.norm(found.state[OFFSET] + 25.0 * drift_mps) < 0.1 + 0.02 * 25.0 * speed_mps
    assert np.linalg.norm(found.state[RATE] + drift_mps) < 0.01 + 0.2 * speed_mps
    assert found.surprise > (9.0 if speed_mps > 0.02 else 6.0)  # the tracker is not sure of its own place after that way


@pytest.mark.parametrize(
    ("scale", "turned"), [(0.015, 0.0), (-0.015, 0.0), (0.0, math.radians(1.0)), (0.01, math.radians(-0.8))]
)
def test_honest_errors_of_the_camera_are_no_offset(scale: float, turned: float) -> None:
    flight = Flight(np.zeros(3))
    flight.fly(60.0, scale=scale, turned=turned)
    assert flight.most_surprising < 1.1


def test_a_step_of_the_tracker_is_no_offset_of_odom() -> None:
    flight = Flight(np.zeros(3))
    flight.fly(40.0, step_m=0.4)
    assert flight.most_surprising < 4.0


def test_a_tracker_that_tilts_against_gravity_is_less_sure_of_its_place() -> None:
    sigmas_m = []
    for tilted in (0.0, math.radians(4.0)):
        found = Flight(np.zeros(3)).fly(40.0, tilted=tilted)
        found.revisit(np.zeros(6), np.full(6, 1e-6))
        sigmas_m.append(math.sqrt(found.wander[1][0]))
    assert sigmas_m[1] > sigmas_m[0] + 0.02


def test_a_direction_that_the_view_does_not_determine_says_nothing() -> None:
    found = OffsetFilter(_flown(0.0), 0.0)
    for n in range(1, 50):
        moved = Pose(_flown(0.0).quat_wxyz, 0.02 * n * np.array([1.0, 1.0, 0.0]))
        found.update(_flown(0.0), moved, np.diag([1.0, 0.0, 1.0]), n * EVERY_S)
    assert found.state[OFFSET][0] > 0.9
    assert abs(found.state[OFFSET][1]) < 0.1


def test_surfaces_seen_before_end_the_wander() -> None:
    found = Flight(np.zeros(3)).fly(40.0)
    assert found.wander[1][0] > 0.05**2
    found.revisit(np.zeros(6), np.full(6, 0.01**2))
    assert found.wander[1][0] == pytest.approx(0.01**2 + 0.03**2, rel=1e-3)
    assert np.linalg.eigvalsh(found.covariance).min() > -1e-12
