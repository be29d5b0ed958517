"""Localizability map of a rendered room: normals, corners, and headings in which a view shows the place."""

from __future__ import annotations

import math

import numpy as np
import pytest
from textured_room import LENS, RGB_LENS, depth_of, frame_of, rgb_of

from uav_recon.geometry.view_information import BLIND_M, GOOD_M, Eye
from uav_recon.mapping.localizability_map import LocalizabilityMap
from uav_recon.types.camera import PosedFrame, body_from_camera
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import GridSpec
from uav_recon.types.pose import Pose

ROOM_M = np.array([[-2.0, -2.0, 0.0], [2.0, 2.0, 2.6]])
GRID = GridSpec.covering(ROOM_M[0] - 0.5, ROOM_M[1] + 0.5, 0.1)
PITCH_RAD = math.radians(10.0)
BODY_FROM_DEPTH = body_from_camera(np.zeros(3), PITCH_RAD)
EYE = Eye((0.5 * LENS.width / LENS.fx, 0.5 * LENS.height / LENS.fy), (0.0, 0.0, 0.0))


def tiles(points: FloatArray) -> FloatArray:
    """Dark tiles of 0.3 m on the wall at x = 2, plain grey elsewhere."""
    dark = (np.floor(points[:, 1] / 0.3) + np.floor(points[:, 2] / 0.3)) % 2
    return np.where(points[:, 0] > 1.98, 0.3 + 0.4 * dark, 0.5)


def posed(stamp_s: float, body: Pose, epoch: int = 0, *, unsure: bool = False) -> PosedFrame:
    pose = body @ BODY_FROM_DEPTH
    seed = round(10.0 * stamp_s)
    frame = frame_of(stamp_s, depth_of(pose, ROOM_M, seed=seed), rgb_of(pose, tiles, ROOM_M, seed=seed, lens=RGB_LENS))
    return PosedFrame(frame, pose, epoch, unsure)


def looked_round() -> LocalizabilityMap:
    """A map after a turn on the spot in the middle of the room, at a height of 1.3 m."""
    surface = LocalizabilityMap(GRID, EYE)
    for n in range(72):
        assert surface.add(posed(0.35 * n, Pose.from_yaw(n * math.tau / 24, np.array([0.0, 0.0, 1.3]))))
    return surface


def test_normals_point_into_the_room_and_corners_lie_on_the_tiles() -> None:
    cells = looked_round().cells
    assert len(cells.area_m2) > 500
    off = np.abs(np.concatenate([cells.position_world - ROOM_M[0], ROOM_M[1] - cells.position_world], axis=1))
    near = off.min(axis=1) < 0.04
    assert near.mean() > 0.9, "surface lies on the walls"
    side = off.argmin(axis=1)
    second = np.partition(off, 1, axis=1)[:, 1] > 0.25
    flat = near & second
    inward = np.where(
        side < 3, cells.normal_world[np.arange(len(side)), side % 3], -cells.normal_world[np.arange(len(side)), side % 3]
    )
    assert np.median(inward[flat]) > 0.995
    assert (inward[flat] > 0.9).mean() > 0.95
    assert (cells.spread[flat] < 0.05).mean() > 0.95
    crossings = ROOM_M[1, 1] * 2.0 / 0.3 * 1.4 / 0.3  # of tiles, at the heights that the colour camera sees
    assert 0.35 * crossings < cells.corners[side == 3].sum() < 1.2 * crossings
    assert cells.corners[side != 3].sum() < 0.05 * crossings


def test_it_names_the_nearest_heading_that_shows_the_place() -> None:
    surface = looked_round()
    bare, painted = Pose.from_yaw(math.pi, np.array([-1.0, 0.0, 1.3])), Pose.from_yaw(0.1, np.array([0.5, 0.0, 1.3]))
    assert surface.sigma_m(bare, PITCH_RAD) > BLIND_M
    assert surface.sigma_m(painted, PITCH_RAD) < GOOD_M
    yaw_rad = surface.seeing_yaw_rad(bare, PITCH_RAD)
    assert yaw_rad is not None
    assert surface.sigma_m(Pose.from_yaw(yaw_rad, bare.translation_m), PITCH_RAD) < GOOD_M
    assert surface.seeing_yaw_rad(painted, PITCH_RAD) == pytest.approx(0.1), "no turn where the view shows the place"
    assert LocalizabilityMap(GRID, EYE).seeing_yaw_rad(bare, PITCH_RAD) is None


def test_frames_that_are_early_or_of_an_uncertain_place_add_nothing_and_another_map_is_new() -> None:
    surface, here = LocalizabilityMap(GRID, EYE), Pose.from_yaw(0.0, np.array([0.0, 0.0, 1.3]))
    assert surface.add(posed(0.0, here))
    assert not surface.add(posed(0.1, here))
    assert not surface.add(posed(0.5, here, unsure=True))
    count = len(surface.cells.area_m2)
    assert surface.add(posed(1.0, Pose.from_yaw(2.0, here.translation_m)))
    assert len(surface.cells.area_m2) > 1.5 * count
    assert surface.add(posed(1.1, here, epoch=1))
    assert len(surface.cells.area_m2) < 1.4 * count
