from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from uav_recon.localization.fusion.filter_pose_gates import (
    FrozenPoseGate,
    PoseGates,
    PoseMeasurement,
    PoseRejection,
    max_step_noise_scale,
    normalized_innovation_squared,
    outlier_noise_scale,
    pose_fault,
)
from uav_recon.types.pose import Pose, StampedPose

GATES = PoseGates()
POSE = StampedPose(10.0, Pose.identity(), np.zeros(3))


def _residual(way_m: float = 0.0, turn_rad: float = 0.0) -> np.ndarray:
    return np.array([0.0, way_m, 0.0, 0.0, 0.0, turn_rad])


def _spread(sigma_m: float = 0.01, sigma_rad: float = 0.005) -> np.ndarray:
    return np.diag([sigma_m**2] * 3 + [sigma_rad**2] * 3)


@pytest.mark.parametrize(
    ("way_m", "sigma_m", "word"),
    [
        (0.0999, 0.001, None),  # below 0.10 m whatever the standard deviation
        (0.1001, 0.001, PoseRejection.JUMP),
        (0.1001, 0.0333, PoseRejection.JUMP),
        (0.1499, 0.05, None),  # within three standard deviations
        (0.1501, 0.05, PoseRejection.JUMP),
        (0.4999, 1.0, None),
        (0.5001, 1.0, PoseRejection.JUMP),  # whatever the standard deviation
        (math.nan, 0.01, PoseRejection.JUMP),
    ],
)
def test_a_jump_is_absolute_and_by_standard_deviations(way_m: float, sigma_m: float, word: PoseRejection | None) -> None:
    assert GATES.leap(_residual(way_m), _spread(sigma_m=sigma_m)) == word


@pytest.mark.parametrize(
    ("turn_deg", "sigma_deg", "word"),
    [
        (7.99, 0.1, None),
        (8.01, 0.1, PoseRejection.TURN),
        (14.9, 5.0, None),
        (15.1, 5.0, PoseRejection.TURN),
        (29.9, 60.0, None),
        (30.1, 60.0, PoseRejection.TURN),
    ],
)
def test_a_turn_likewise(turn_deg: float, sigma_deg: float, word: PoseRejection | None) -> None:
    spread = _spread(sigma_rad=math.radians(sigma_deg))
    assert GATES.leap(_residual(turn_rad=math.radians(turn_deg)), spread) == word


def test_the_standard_deviation_counts_along_the_jump() -> None:
    spread = np.diag([1.0, 1e-6, 1.0, 1e-6, 1e-6, 1e-6])
    assert GATES.leap(_residual(0.3), spread) == PoseRejection.JUMP
    assert GATES.leap(np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0]), spread) is None


@pytest.mark.parametrize(("way_m", "word"), [(0.299, None), (0.301, PoseRejection.SPEED)])
def test_two_metres_a_second_is_the_fastest_way(way_m: float, word: PoseRejection | None) -> None:
    before = PoseMeasurement(10.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), POSE)
    after = PoseMeasurement(10.1, (way_m, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), POSE)
    assert GATES.speed_fault(before, after) == GATES.speed_fault(after, before) == word


@pytest.mark.parametrize(
    ("pose", "word"),
    [
        (POSE, None),
        (replace(POSE, stamp_s=math.nan), PoseRejection.NOT_FINITE),
        (replace(POSE, covariance=np.full((6, 6), math.inf)), PoseRejection.NOT_FINITE),
        (replace(POSE, covariance=np.eye(3)), PoseRejection.NOT_FINITE),
        (replace(POSE, covariance=np.diag([1e39] * 3 + [1e-5] * 3)), PoseRejection.OUT_OF_RANGE),
        (replace(POSE, covariance=np.diag([1e-4] * 5 + [10_001.0])), PoseRejection.OUT_OF_RANGE),
        (replace(POSE, covariance=np.diag([1e-4] * 5 + [10_000.0])), None),
        (replace(POSE, odom_from_body=Pose.from_yaw(0.0, np.array([0.0, -10_001.0, 0.0]))), PoseRejection.OUT_OF_RANGE),
        (replace(POSE, odom_from_body=Pose.from_yaw(0.0, np.array([0.0, -10_000.0, 0.0]))), None),
        (replace(POSE, quality=0), PoseRejection.QUALITY),
        (replace(POSE, stamp_s=9.06), None),
        (replace(POSE, stamp_s=9.04), PoseRejection.STAMP),
        (replace(POSE, stamp_s=10.059), None),
        (replace(POSE, stamp_s=10.061), PoseRejection.STAMP),
    ],
)
def test_what_is_wrong_with_a_pose_by_itself(pose: StampedPose, word: PoseRejection | None) -> None:
    assert pose_fault(pose, now_s=10.05) == word


def test_the_surprise_is_the_squared_distance_in_standard_deviations() -> None:
    residual = np.array([0.02, 0.0, 0.0, 0.0, 0.01, 0.0])
    assert normalized_innovation_squared(residual, _spread()) == pytest.approx(4.0 + 4.0)


def test_an_implausible_pose_counts_for_less_a_plausible_one_in_full() -> None:
    assert outlier_noise_scale(6.0) == outlier_noise_scale(22.4) == 1.0
    assert outlier_noise_scale(224.6) == pytest.approx(10.0)


@pytest.mark.parametrize(("way_m", "track_m2"), [(0.01, 1e-4), (0.1, 1e-4), (0.4, 0.04), (0.05, 1.0)])
def test_no_pose_moves_odometry_by_more_than_three_centimetres(way_m: float, track_m2: float) -> None:
    white_m2 = 1.5e-5
    times = max_step_noise_scale(_residual(way_m), track_m2, white_m2)
    step_m = way_m * track_m2 / (track_m2 + times * white_m2)
    assert times >= 1.0
    assert step_m <= 0.03 + 1e-12
    if times > 1.0:
        assert step_m == pytest.approx(0.03)


@pytest.mark.parametrize(
    ("residual", "repeats"), [((0.03, 0, 0, 0, 0, 0), True), ((0, 0, 0, 0, 0, 0.03), True), ((0.01,) * 6, False)]
)
def test_a_pose_that_repeats_is_frozen_once_the_track_has_left_it(residual: tuple[float, ...], repeats: bool) -> None:
    gate, pose = FrozenPoseGate(), Pose.from_yaw(0.3, np.array([1.0, 2.0, 1.2]))
    assert not gate.repeats(pose, np.array(residual))
    assert gate.repeats(Pose(pose.quat_wxyz, pose.translation_m), np.array(residual)) is repeats
    assert not gate.repeats(Pose.from_yaw(0.3, np.array([1.0, 2.0, 1.2 + 1e-9])), np.array(residual))
