"""Surfaces by when they were first seen."""

from __future__ import annotations

import numpy as np

from uav_recon.localization.correction.revisited_surfaces import RevisitedSurfaces, Wandered
from uav_recon.types.camera import Frame, Intrinsics
from uav_recon.types.pose import Pose

LENS = Intrinsics.from_fov(64, 48, 1.5, 1.2)


def _wall(away_m: float = 2.0) -> Frame:
    return Frame(0.0, 0, np.full((48, 64), away_m, np.float32), LENS, np.zeros((2, 2, 3), np.uint8), LENS, Pose.identity())


def _wandered(place_m: float) -> Wandered:
    return Wandered(np.repeat((place_m, 0.0), 3), np.repeat((place_m**2, 1e-4), 3))


def _at(x_m: float) -> Pose:
    return Pose.from_yaw(0.0, np.array([x_m, 0.0, 0.0]))


def test_the_wander_at_the_first_sight_is_returned_after_a_way_only() -> None:
    surfaces, first = RevisitedSurfaces(), _wandered(0.01)
    assert surfaces.look(_wall(), _at(0.1), 0.0, first) is None
    assert surfaces.look(_wall(), _at(0.1), 2.0, _wandered(0.05)) is None
    again = surfaces.look(_wall(), _at(0.1), 8.0, _wandered(0.1))
    assert again is not None
    np.testing.assert_allclose(again.mean, first.mean)
    np.testing.assert_allclose(again.variance, first.variance)


def test_new_surfaces_and_an_empty_view_say_nothing() -> None:
    surfaces = RevisitedSurfaces()
    surfaces.look(_wall(), _at(0.1), 0.0, _wandered(0.01))
    assert surfaces.look(_wall(), _at(20.0), 8.0, _wandered(0.1)) is None
    assert surfaces.look(_wall(np.nan), _at(0.1), 9.0, _wandered(0.1)) is None
