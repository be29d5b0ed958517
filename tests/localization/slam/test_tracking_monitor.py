"""Limits of one registered frame, each from both sides."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from uav_recon.localization.slam.keyframe_map import no_keyframes
from uav_recon.localization.slam.place_errors import PlaceErrors
from uav_recon.localization.slam.rgbd_registration import MotionPrior, Registration
from uav_recon.localization.slam.tracking_monitor import TrackingFault, TrackingMonitor
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

HERE = Pose.from_yaw(0.4, np.array([1.0, 2.0, 0.5]))


def _prior(turn_sigma_rad: float = math.radians(0.1), place_sigma_m: float = 0.005) -> MotionPrior:
    places = PlaceErrors.start(np.zeros((3, 3)))
    places = places.with_lag().with_lag().predicted(np.diag([0.0, place_sigma_m**2, 0.0]), np.eye(3))
    turn = turn_sigma_rad**2 * np.eye(3)
    return MotionPrior(HERE, turn, places, turn_sigma_rad, np.zeros(3), np.zeros(3), np.zeros(2), np.eye(2))


def _found(step_m: float = 0.0, turn_rad: float = 0.0, landmarks: int = 60, **values: Any) -> Registration:
    pose = Pose.from_rotation_vector(np.array([0.0, turn_rad, 0.0]), np.zeros(3)) @ HERE
    moved_m = np.array([step_m, 0.0, 0.0, 0.0, 0.0, 0.0])
    good = Registration(
        Pose(pose.quat_wxyz, HERE.translation_m + moved_m[:3]), no_keyframes(), 1e-6 * np.eye(6), moved_m, 1e-6 * np.eye(6),
        1e-6 * np.eye(3), np.eye(3), 1000, 900, 850, np.array([landmarks]), np.zeros(2), np.eye(2), 0.01, 1e4,
    )  # fmt: skip
    return dataclasses.replace(good, **values)


def _loose(element: int, sigma: float) -> FloatArray:
    covariance = 1e-6 * np.eye(6)
    covariance[element, element] = sigma**2
    return covariance


def _vague(sigma_m: float) -> FloatArray:
    return np.diag([1e-6, sigma_m**2, 1e-6])


def _fault(found: Registration, prior: MotionPrior | None = None) -> TrackingFault | None:
    return TrackingMonitor().fault(found, _prior() if prior is None else prior)


def test_a_good_frame_has_no_fault() -> None:
    assert _fault(_found()) is None


@pytest.mark.parametrize(
    ("inside", "outside", "fault"),
    [
        (_found(points=150, known=100, inliers=90), _found(points=149, known=100, inliers=90), TrackingFault.FEW_POINTS),
        (_found(inliers=496, landmarks=39), _found(inliers=494, landmarks=39), TrackingFault.FIT),
        (_found(inliers=496), _found(inliers=494), TrackingFault.DEPTH),
        (_found(known=149, inliers=10, landmarks=39), _found(known=151, inliers=10, landmarks=39), TrackingFault.FIT),
        (_found(known=890, turn_rad=math.radians(0.79)), _found(known=890, turn_rad=math.radians(0.81)), TrackingFault.TURN),
        (_found(turn_rad=math.radians(2.9)), _found(turn_rad=math.radians(3.1)), TrackingFault.TURN),  # all of it fits
        (_found(step_m=0.059), _found(step_m=0.061), TrackingFault.STEP),
        (_found(against_track=_vague(0.079)), _found(against_track=_vague(0.081)), TrackingFault.LOOSE),
        (_found(covariance=_loose(1, math.radians(1.9))), _found(covariance=_loose(1, math.radians(2.1))), TrackingFault.LOOSE),
    ],
)  # fmt: skip
def test_each_limit_from_both_sides(inside: Registration, outside: Registration, fault: TrackingFault) -> None:
    assert _fault(inside) is None
    assert _fault(outside) is fault


def test_an_uncertain_turn_allows_a_larger_one() -> None:
    wide = _prior(turn_sigma_rad=math.radians(1.0))
    assert _fault(_found(turn_rad=math.radians(5.9)), wide) is None
    assert _fault(_found(turn_rad=math.radians(6.1)), wide) is TrackingFault.TURN


def test_an_uncertain_attitude_allows_a_larger_turn() -> None:
    prior = _prior()
    prior.attitude_covariance[1, 1] = math.radians(0.5) ** 2
    assert _fault(_found(known=890, turn_rad=math.radians(1.4)), prior) is None
    assert _fault(_found(known=890, turn_rad=math.radians(1.6)), prior) is TrackingFault.TURN


def test_an_uncertain_place_allows_a_larger_step() -> None:
    wide = _prior(place_sigma_m=0.04)
    assert _fault(_found(step_m=0.199), wide) is None
    assert _fault(_found(step_m=0.201), wide) is TrackingFault.STEP


def test_a_frame_without_any_points_is_one_of_few() -> None:
    nothing = _found(points=0, known=0, inliers=0)
    assert nothing.coverage == 0.0
    assert nothing.fit == 0.0
    assert _fault(nothing) is TrackingFault.FEW_POINTS
