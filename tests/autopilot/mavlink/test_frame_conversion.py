"""ENU/FLU against NED/FRD, judged by matrices and scipy."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from uav_recon.autopilot.mavlink.frame_conversion import swap_attitude, swap_body, swap_covariance, swap_world, swap_yaw
from uav_recon.types.frames import FloatArray

NED_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD_FLU = np.diag([1.0, -1.0, -1.0])
NUMBER = st.floats(-1e3, 1e3)
VECTOR = arrays(np.float64, 3, elements=NUMBER)
QUAT = arrays(np.float64, 4, elements=st.floats(-1.0, 1.0)).filter(lambda q: np.linalg.norm(q) > 0.1)


def matrix(quat_wxyz: FloatArray) -> FloatArray:
    return np.asarray(Rotation.from_quat(np.roll(quat_wxyz, -1)).as_matrix())


@given(VECTOR)
def test_vectors(vector: FloatArray) -> None:
    np.testing.assert_array_equal(swap_world(vector), NED_ENU @ vector)
    np.testing.assert_array_equal(swap_body(vector), FRD_FLU @ vector)
    np.testing.assert_array_equal(swap_world(np.array(swap_world(vector))), vector)
    np.testing.assert_array_equal(swap_body(np.array(swap_body(vector))), vector)


@given(QUAT)
def test_attitudes(quat: FloatArray) -> None:
    quat = quat / np.linalg.norm(quat)
    there = np.array(swap_attitude(quat))
    np.testing.assert_allclose(matrix(there), NED_ENU @ matrix(quat) @ FRD_FLU, atol=1e-12)
    np.testing.assert_allclose(matrix(np.array(swap_attitude(there))), matrix(quat), atol=1e-12)


@given(st.floats(-20.0, 20.0))
def test_headings(yaw: float) -> None:
    forward_ned = NED_ENU @ [math.cos(yaw), math.sin(yaw), 0.0]
    turn = swap_yaw(yaw) - math.atan2(forward_ned[1], forward_ned[0])
    assert abs(math.remainder(turn, math.tau)) < 1e-9
    assert abs(math.remainder(swap_yaw(swap_yaw(yaw)) - yaw, math.tau)) < 1e-9
    assert -math.pi <= swap_yaw(yaw) <= math.pi


def test_known_headings() -> None:
    assert swap_yaw(0.0) == math.pi / 2, "east"
    assert swap_yaw(math.pi / 2) == 0.0, "north"


def test_covariance_is_that_of_turned_samples() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6))
    samples = rng.normal(size=(200_000, 6)) @ root.T
    turned = np.hstack([samples[:, :3] @ NED_ENU.T, samples[:, 3:] @ NED_ENU.T])
    expected = np.cov(turned.T)
    np.testing.assert_allclose(swap_covariance(root @ root.T), expected, atol=0.03 * np.abs(expected).max())
    np.testing.assert_allclose(swap_covariance(swap_covariance(root @ root.T)), root @ root.T)
