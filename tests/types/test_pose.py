from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uav_recon.types.camera import BODY_FROM_OPTICAL, body_from_camera
from uav_recon.types.pose import Pose, StampedPose

metres = st.tuples(*[st.floats(-100.0, 100.0)] * 3).map(np.array)
rotation_vectors = st.tuples(*[st.floats(-4.0, 4.0)] * 3).map(np.array)


def _pose(rotation_rad: np.ndarray, translation_m: np.ndarray) -> tuple[Pose, np.ndarray]:
    """Return our pose, and the homogeneous matrix made by scipy."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(rotation_rad).as_matrix()
    matrix[:3, 3] = translation_m
    return Pose.from_rotation_vector(rotation_rad, translation_m), matrix


poses = st.builds(_pose, rotation_vectors, metres)


@given(poses, poses, metres)
def test_pose_algebra_equals_matrix_algebra(a: tuple[Pose, np.ndarray], b: tuple[Pose, np.ndarray], point: np.ndarray) -> None:
    np.testing.assert_allclose(a[0].matrix(), a[1], atol=1e-9)
    np.testing.assert_allclose((a[0] @ b[0]).matrix(), a[1] @ b[1], atol=1e-9)
    np.testing.assert_allclose(a[0].inverse().matrix(), np.linalg.inv(a[1]), atol=1e-9)
    np.testing.assert_allclose(a[0].apply(point), (a[1] @ [*point, 1.0])[:3], atol=1e-9)
    np.testing.assert_allclose(a[0].apply(np.stack([point, 2 * point]))[1], a[0].apply(2 * point), atol=1e-9)


@given(poses)
def test_from_matrix_inverts_matrix(a: tuple[Pose, np.ndarray]) -> None:
    again = Pose.from_matrix(a[1])
    np.testing.assert_allclose(again.matrix(), a[1], atol=1e-9)


@pytest.mark.parametrize("axis", np.eye(3))
@pytest.mark.parametrize("angle_rad", [0.0, 1e-13, 1e-9, np.pi / 2, np.pi - 1e-9, np.pi])
def test_from_matrix_at_its_branch_points(axis: np.ndarray, angle_rad: float) -> None:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(angle_rad * axis).as_matrix()
    np.testing.assert_allclose(Pose.from_matrix(matrix).matrix(), matrix, atol=1e-12)


@given(poses)
def test_yaw_is_the_heading_of_the_x_axis(a: tuple[Pose, np.ndarray]) -> None:
    x_axis = a[1][:3, 0]
    if np.hypot(x_axis[0], x_axis[1]) > 1e-3:
        error = a[0].yaw_rad() - np.arctan2(x_axis[1], x_axis[0])
        assert abs((error + np.pi) % (2 * np.pi) - np.pi) < 1e-6


@given(st.floats(-3.14, 3.14))
def test_a_level_pose_has_the_yaw_it_was_made_from(yaw_rad: float) -> None:
    assert Pose.from_yaw(yaw_rad, np.zeros(3)).yaw_rad() == pytest.approx(yaw_rad, abs=1e-12)


def test_a_quaternion_is_normalised_and_frozen() -> None:
    quat = np.array([2.0, 0.0, 0.0, 0.0])
    pose = Pose(quat, np.zeros(3))
    np.testing.assert_array_equal(pose.quat_wxyz, [1.0, 0.0, 0.0, 0.0])
    quat[0] = 7.0  # the pose does not keep the caller's array
    np.testing.assert_array_equal(pose.quat_wxyz, [1.0, 0.0, 0.0, 0.0])
    with pytest.raises(ValueError, match="read-only"):
        pose.translation_m[0] = 1.0


@pytest.mark.parametrize(
    ("quat", "translation"),
    [
        ([0, 0, 0, 0], [0, 0, 0]),
        ([1, 0, 0, np.nan], [0, 0, 0]),
        ([1, 0, 0, np.inf], [0, 0, 0]),
        ([1, 0, 0, 0], [0, np.nan, 0]),
        ([1, 0, 0, 0], [0, 0, -np.inf]),
        ([1, 0, 0], [0, 0, 0]),
        ([1, 0, 0, 0], [0, 0]),
    ],
)
def test_an_invalid_pose_cannot_be_made(quat: list[float], translation: list[float]) -> None:
    with pytest.raises(ValueError, match="pose"):
        Pose(np.array(quat, dtype=float), np.array(translation, dtype=float))


def test_an_optical_camera_on_a_level_body_looks_along_x() -> None:
    np.testing.assert_array_equal(body_from_camera(np.zeros(3), 0.0).matrix(), BODY_FROM_OPTICAL)
    down = body_from_camera(np.array([0.1, 0.0, 0.0]), np.pi / 2)
    np.testing.assert_allclose(down.apply(np.array([0.0, 0.0, 1.0])), [0.1, 0.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(down.apply(np.array([1.0, 0.0, 0.0])), [0.1, -1.0, 0.0], atol=1e-12)  # optical x is body right


@given(rotation_vectors)
def test_the_rotation_vector_is_that_of_the_smaller_angle(rotation_rad: np.ndarray) -> None:
    pose, matrix = _pose(rotation_rad, np.zeros(3))
    found = pose.rotation_vector()
    assert np.linalg.norm(found) <= np.pi + 1e-9
    np.testing.assert_allclose(Rotation.from_rotvec(found).as_matrix(), matrix[:3, :3], atol=1e-9)


def test_the_uncertainty_of_the_place_is_that_in_the_worst_direction() -> None:
    spread = np.diag([0.01**2, 0.05**2, 0.02**2, 1.0, 1.0, 1.0])
    pose = StampedPose(0.0, Pose.identity(), np.zeros(3), spread)
    assert pose.place_sigma_m == pytest.approx(0.05)
    assert pose.moved(Pose.from_yaw(0.7, np.zeros(3))).place_sigma_m == pytest.approx(0.05)


@pytest.mark.parametrize("covariance", [np.eye(3), np.full((6, 6), np.nan), np.diag([np.inf] * 6)])
def test_a_covariance_that_tells_no_uncertainty_of_the_place_gives_none(covariance: np.ndarray) -> None:
    assert np.isnan(StampedPose(0.0, Pose.identity(), np.zeros(3), covariance).place_sigma_m)
