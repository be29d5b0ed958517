from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sitl.geometry import ned_frd, quaternion


def scipy_of(q: tuple[float, ...]) -> Rotation:
    return Rotation.from_quat(np.roll(q, -1))


def some(seed: int) -> tuple[float, float, float, float]:
    x, y, z, w = Rotation.random(random_state=seed).as_quat()
    return (float(w), float(x), float(y), float(z))


@pytest.mark.parametrize("seed", range(8))
def test_algebra_agrees_with_scipy(seed: int) -> None:
    a, b = some(seed), some(seed + 100)
    v = (0.3, -1.2, 2.0)
    assert scipy_of(quaternion.multiply(a, b)).as_matrix() == pytest.approx((scipy_of(a) * scipy_of(b)).as_matrix(), abs=1e-12)
    assert quaternion.rotate(a, v) == pytest.approx(tuple(scipy_of(a).apply(v)), abs=1e-12)
    yaw, pitch, roll = scipy_of(a).as_euler("ZYX")
    assert quaternion.euler_of(a) == pytest.approx((roll, pitch, yaw), abs=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_ned_frd_attitude_agrees_with_matrices(seed: int) -> None:
    q = some(seed)
    ned_from_enu = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    flu_from_frd = np.diag([1, -1, -1])
    expected = ned_from_enu @ scipy_of(q).as_matrix() @ flu_from_frd
    assert scipy_of(ned_frd.ned_frd_from_enu_flu(q)).as_matrix() == pytest.approx(expected, abs=1e-12)


def test_facing_east_is_a_heading_of_90_degrees() -> None:
    q = ned_frd.ned_frd_from_enu_flu((1.0, 0.0, 0.0, 0.0))
    assert quaternion.yaw_of(q) == pytest.approx(math.pi / 2)


def test_small_rotations_round_trip() -> None:
    turn = (0.01, -0.02, 0.015)
    q = quaternion.from_small_rotation(*turn)
    assert scipy_of(q).as_rotvec() == pytest.approx(turn, abs=1e-8)
    assert quaternion.small_rotation(q) == pytest.approx(turn, abs=1e-5)


def test_wrapped_angles_are_between_minus_pi_and_pi() -> None:
    for angle in np.linspace(-20.0, 20.0, 401):
        w = quaternion.wrapped(float(angle))
        assert -math.pi <= w < math.pi
        assert math.cos(w) == pytest.approx(math.cos(angle), abs=1e-9)
