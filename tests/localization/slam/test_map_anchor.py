"""Map anchor: what is new may not make the place more certain, and what is old may."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from uav_recon.localization.slam.landmarks import Landmarks
from uav_recon.localization.slam.map_anchor import SURE_M, MapAnchor
from uav_recon.localization.slam.rgbd_registration import Registration
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

LOST = float("inf")
NEAR = 1e-4 * np.eye(3)  # covariance of a place that landmarks hold


def _found(**values: Any) -> Registration:
    whole = np.eye(6) * 1e-4
    good = Registration(Pose.identity(), whole, 1000, 950, 940, 40, np.zeros(2), np.eye(2), 0.01, 1e5)
    return dataclasses.replace(good, **values)


def _landmarks(born_m: list[float]) -> Landmarks:
    count = len(born_m)
    return Landmarks.none()._replace(born_m=np.array(born_m), place_m=np.zeros((count, 3)))


def _sigma(sigma_m: float) -> FloatArray:
    return sigma_m**2 * np.eye(3)


def test_new_landmarks_keep_the_uncertainty_that_they_were_born_with() -> None:
    anchor = MapAnchor()
    for _ in range(20):
        anchor.settle(_found(depth_sigma_m=LOST), _landmarks([0.2] * 40), _sigma(0.2), False)
    assert anchor.total_m(NEAR) == pytest.approx(0.2, abs=0.01)


def test_a_few_new_points_of_depth_do_not_end_it() -> None:
    anchor = MapAnchor()
    anchor.settle(_found(depth_sigma_m=LOST, landmarks=0), Landmarks.none(), _sigma(0.25), False)
    assert anchor.total_m(NEAR) == pytest.approx(0.25, abs=0.01)


def test_old_landmarks_and_a_proven_place_end_it() -> None:
    anchor = MapAnchor()
    anchor.settle(_found(depth_sigma_m=LOST), _landmarks([0.01] * 30 + [0.2] * 10), _sigma(0.2), False)
    assert anchor.total_m(NEAR) < SURE_M
    anchor.settle(_found(depth_sigma_m=LOST), _landmarks([0.2] * 40), _sigma(0.2), False)
    anchor.settle(_found(), _landmarks([0.2] * 40), _sigma(0.2), True)
    assert anchor.total_m(NEAR) < SURE_M


def test_depth_alone_ends_it_only_near_the_prediction() -> None:
    """From afar the nearest fit may be another wall."""
    near, far = MapAnchor(), MapAnchor()
    near.settle(_found(landmarks=0), Landmarks.none(), _sigma(0.99 * SURE_M), False)
    far.settle(_found(landmarks=0), Landmarks.none(), _sigma(0.3), False)
    assert near.total_m(NEAR) < SURE_M
    assert far.total_m(NEAR) == pytest.approx(0.3, abs=0.02)
