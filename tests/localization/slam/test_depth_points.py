"""Equations of depth points against several keyframes: the kernel against plain numpy."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from slam_flight import BODY_FROM_DEPTH, RATE_HZ, frame, truth

from uav_recon.localization.slam.depth_points import SURFACE_M, add_depth_equations
from uav_recon.localization.slam.keyframe_map import KeyframeMap, Keyframes
from uav_recon.localization.slam.prepared_view import PreparedView
from uav_recon.types.frames import BoolArray, FloatArray
from uav_recon.types.pose import Pose

NUMBER = 210  # of the frame that is compared
SHARE, HIDDEN_M, INLIER_M = 0.3, 0.6, 0.08
HERE = truth(NUMBER / RATE_HZ) @ BODY_FROM_DEPTH


@functools.cache
def compared() -> tuple[FloatArray, Keyframes]:
    """Return the points of a view, and the keyframes that it is compared with."""
    surfaces, view = KeyframeMap(), PreparedView(frame(NUMBER))
    for number in (NUMBER - 90, NUMBER - 60, NUMBER - 20):
        pose = truth(number / RATE_HZ) @ BODY_FROM_DEPTH
        surfaces.add(PreparedView(frame(number)), pose, np.zeros(6), np.zeros(2), np.zeros(3), 0)
    return view.points, surfaces.near_view(view, HERE, np.zeros(6), np.zeros(2))[0]


def _matches(
    points: FloatArray, pose: Pose, keyframes: Keyframes, m: int, doubt: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray]:
    """Return the distances (N,) to a keyframe, the normals (N, 3), which points lie near it, and which before it."""
    there = (pose.apply(points) - keyframes.place_m[m]) @ keyframes.rotation[m]
    fx, fy, cx, cy = keyframes.camera[m]
    z = np.maximum(there[:, 2], 0.1)
    u, v = np.floor(there[:, 0] / z * fx + cx + 0.5), np.floor(there[:, 1] / z * fy + cy + 0.5)
    height, width = keyframes.depth_m.shape[1:]
    inside = (there[:, 2] >= 0.1) & (u >= 0) & (v >= 0) & (u < width) & (v < height)
    column, row, image = np.where(inside, u, 0).astype(int), np.where(inside, v, 0).astype(int), keyframes.number[m]
    seen, normal = keyframes.depth_m[image][row, column].astype(float), keyframes.normal[image][row, column].astype(float)
    off = np.einsum(
        "na,na->n", normal, there - np.column_stack(((column - cx) / fx, (row - cy) / fy, np.ones(len(u)))) * seen[:, None]
    )
    shown = inside & (seen > 0.0) & (normal[:, 2] != 0.0) & (there[:, 2] - seen <= HIDDEN_M)
    eye = (pose.translation_m - keyframes.place_m[m]) @ keyframes.rotation[m]
    faces = np.einsum("na,na->n", normal, eye - there) >= 0.0
    normal = normal @ keyframes.rotation[m].T
    certain = np.einsum("na,ab,nb->n", normal, doubt, normal) <= 1.0
    return off, normal, shown & faces & certain & (np.abs(off) <= SURFACE_M), shown & (off > SURFACE_M) & (not doubt.any())


def _plain(
    points: FloatArray, pose: Pose, keyframes: Keyframes, doubt: FloatArray, wider: float
) -> tuple[FloatArray, FloatArray, int, int]:
    """Return information (M, 6, 6), gradient (M, 6), and the numbers of known points and of inliers."""
    most = len(keyframes.number)
    found = [_matches(points, pose, keyframes, m, doubt[m]) for m in range(most)]
    near, before = np.array([each[2] for each in found]), np.array([each[3] for each in found])
    sigma_m, turned = 0.008 + 0.003 * points[:, 2] ** 2, points @ pose.rotation().T
    information, gradient = np.zeros((most, 6, 6)), np.zeros((most, 6))
    for m, (off, normal, _, _) in enumerate(found):
        rows = np.hstack((np.cross(turned, normal), normal))[near[m]]
        shrink = 1.0 / (1.0 + (off / (wider * np.maximum(0.02, 2.0 * sigma_m))) ** 2)
        weight = (SHARE / np.maximum(near.sum(axis=0), 1) * shrink**2 / sigma_m**2)[near[m]]
        information[m], gradient[m] = (rows * weight[:, None]).T @ rows, -rows.T @ (weight * off[near[m]])
    inliers = (near & (np.abs([each[0] for each in found]) < INLIER_M)).any(axis=0)
    return information, gradient, int((near.any(axis=0) | before.any(axis=0)).sum()), int(inliers.sum())


@pytest.mark.parametrize("wider", [1.0, 4.0])
@pytest.mark.parametrize("doubted", [0.0, 3.0])
@pytest.mark.parametrize("moved_m", [(0.0, 0.0, 0.0), (0.05, -0.02, 0.12)])
def test_the_equations_are_those_of_plain_numpy(wider: float, doubted: float, moved_m: tuple[float, float, float]) -> None:
    points, keyframes = compared()
    most = len(keyframes.number)
    assert most > 1
    pose = Pose(HERE.quat_wxyz, HERE.translation_m + np.array(moved_m))
    doubt = np.zeros((most, 3, 3))
    doubt[-1] = np.diag([doubted, 0.0, 0.0])
    information, gradient = np.zeros((most, 8, 8)), np.zeros((most, 8))
    counts = add_depth_equations(
        points, pose.rotation(), pose.translation_m, keyframes, doubt, SHARE, wider, information, gradient
    )
    expected, slope, *counted = _plain(points, pose, keyframes, doubt, wider)
    assert min(counted) > 200
    assert list(counts) == counted
    np.testing.assert_allclose(information[:, :6, :6], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(gradient[:, :6], slope, rtol=1e-9, atol=1e-9 * np.abs(slope).max())
    assert not information[:, 6:].any()
    alone, pull = np.zeros((most, 6, 6)), np.zeros((most, 6))
    add_depth_equations(points, pose.rotation(), pose.translation_m, keyframes, doubt, SHARE, wider, alone, pull, False)
    np.testing.assert_allclose(alone[:, 3:, 3:], information[:, 3:6, 3:6], rtol=1e-12)
    np.testing.assert_allclose(pull[:, 3:], gradient[:, 3:6], rtol=1e-12)
    assert not (alone[:, :3].any() or pull[:, :3].any())
