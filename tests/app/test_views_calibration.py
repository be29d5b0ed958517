"""Errors from the views of a walk: none from too few views, no scale from its own poses, a box of bounded size."""

from __future__ import annotations

import dataclasses

import numpy as np
from box_room import DEPTH_LENS, HIGH, LOW, NOISE_PX, tour, view_from

from uav_recon.app.views_calibration import LARGEST_M3, PADDING_M, errors_from_views, walked_box
from uav_recon.config import CameraConfig
from uav_recon.mapping.neural.neural_mapper import ADJUST_VIEWS
from uav_recon.types.camera import PosedFrame
from uav_recon.types.camera_calibration import ERROR_SIGMAS, HIDDEN_BY_OWN_POSES
from uav_recon.types.pose import Pose

SCALE = 0.014
CAMERA = CameraConfig(depth_noise_px=NOISE_PX)


def walk(count: int) -> list[PosedFrame]:
    """Return views of a camera whose depth is too large by SCALE."""
    views = []
    for n, posed in enumerate(tour(count)):
        seen = view_from(posed.world_from_depth, DEPTH_LENS, n, NOISE_PX)
        frame = dataclasses.replace(seen.frame, stamp_s=0.5 * n, depth_m=seen.frame.depth_m * np.float32(1 + SCALE))
        views.append(PosedFrame(frame, posed.world_from_depth))
    return views


def test_errors_show_unless_the_poses_have_them_too() -> None:
    reports: list[tuple[int, int]] = []
    for own_poses in (False, True):
        found = errors_from_views(walk(24), CAMERA, own_poses=own_poses, report=lambda *done: reports.append(done))
        assert found is not None
        sigmas = {name: sigma for name, _, sigma in found}
        value, sigma = {name: known for name, *known in found}["depth_scale"]
        prior = ERROR_SIGMAS["depth_scale"]
        if own_poses:
            assert all(sigmas[name] == ERROR_SIGMAS[name] for name in HIDDEN_BY_OWN_POSES)
            assert sigmas["width"] < 0.7 * ERROR_SIGMAS["width"]
        else:
            assert abs(value - SCALE) < 0.004
            assert sigma < 0.5 * prior
    assert reports[:24] == [(n, 24) for n in range(24)]


def test_too_few_views_show_nothing() -> None:
    views = walk(ADJUST_VIEWS)
    assert errors_from_views(views[:-1], CAMERA, own_poses=False) is None
    blind = dataclasses.replace(views[0].frame, depth_m=np.full_like(views[0].frame.depth_m, np.nan))
    assert errors_from_views([*views[:-1], dataclasses.replace(views[0], frame=blind)], CAMERA, own_poses=False) is None


def test_the_box_holds_the_room_and_no_more() -> None:
    low_m, high_m = walked_box(walk(24))
    assert (low_m < LOW).all()
    assert (high_m[:2] > HIGH[:2]).all()  # the views look down: no ceiling
    assert (high_m - low_m < HIGH - LOW + 2 * PADDING_M + 0.3).all()


def test_the_box_of_a_long_way_has_a_bounded_size() -> None:
    views = walk(6)
    far = Pose(views[0].world_from_depth.quat_wxyz, np.array([500.0, 300.0, 0.0]))
    low_m, high_m = walked_box([*views, dataclasses.replace(views[0], world_from_depth=far)])
    assert np.prod(high_m - low_m) <= 1.001 * LARGEST_M3
    assert (low_m < LOW).all()
    assert (high_m[:2] > HIGH[:2]).all()
