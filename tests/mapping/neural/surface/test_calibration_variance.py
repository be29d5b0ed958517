"""What the errors of the camera may shift a surface by: as much after a thousand measurements as after one."""

from __future__ import annotations

import numpy as np
import pytest

from uav_recon.mapping.neural.surface.calibration_variance import STRIDE, CalibratedAgreement, CalibrationVariance
from uav_recon.mapping.neural.surface.uncertainty import MeasuredAgreement
from uav_recon.types.camera import body_from_camera
from uav_recon.types.camera_calibration import ERROR_SIGMAS, CameraMotion
from uav_recon.types.frames import Float32Array, FloatArray
from uav_recon.types.pose import Pose

NAMES = list(ERROR_SIGMAS)
LOW, HIGH = np.zeros(3), np.full(3, 4.0)
CAMERA = body_from_camera(np.array([1.0, 2.0, 1.0]), 0.0)  # looks along x
WALL_X_M = 3.0


def wall(count: int, x_m: float = WALL_X_M) -> tuple[Float32Array, Float32Array]:
    """Return points of a wall before the camera, and their normals."""
    random = np.random.default_rng(1)
    points = np.column_stack([np.full(count, x_m), random.uniform(1.0, 3.0, count), random.uniform(0.5, 1.5, count)])
    return points.astype(np.float32), np.tile(np.array([-1.0, 0.0, 0.0], dtype=np.float32), (count, 1))


def variance_of(**sigma: float) -> CalibrationVariance:
    variance = CalibrationVariance(LOW, HIGH)
    variance.covariance = np.diag([sigma.get(name, 0.0) ** 2 for name in NAMES])
    return variance


def at(variance: CalibrationVariance, point: tuple[float, float, float]) -> float:
    return float(variance.at(np.array([point], dtype=np.float32))[0])


@pytest.mark.parametrize("views", [1, 20])
def test_more_views_of_one_kind_do_not_reduce_it(views: int) -> None:
    variance = variance_of(depth_scale=0.005)
    for _ in range(views):
        variance.add(*wall(40_000), CameraMotion.at_rest(CAMERA))
    assert np.sqrt(at(variance, (WALL_X_M, 2.0, 1.0))) == pytest.approx(0.005 * (WALL_X_M - 1.0), rel=0.02)


def test_views_from_both_sides_show_a_wall_at_its_place() -> None:
    """A camera that is before its nominal place sees both walls too near: the middle of two opposite views does not move."""
    variance = variance_of(offset_z_m=0.01)
    points, normal = wall(40_000, 2.0)
    variance.add(points, normal, CameraMotion.at_rest(CAMERA))
    assert np.sqrt(at(variance, (2.0, 2.0, 1.0))) == pytest.approx(0.01, rel=0.02)
    back = Pose.from_yaw(np.pi, np.array([3.0, 2.0, 1.0])) @ body_from_camera(np.zeros(3), 0.0)
    variance.add(points, normal, CameraMotion.at_rest(back))
    assert np.sqrt(at(variance, (2.0, 2.0, 1.0))) < 0.001


def test_a_late_camera_leaves_doubt_where_it_moved() -> None:
    variance = variance_of(delay_s=0.01)
    variance.add(*wall(40_000), CameraMotion(CAMERA, np.array([0.5, 0.0, 0.0]), np.zeros(3)))
    assert np.sqrt(at(variance, (WALL_X_M, 2.0, 1.0))) == pytest.approx(0.005, rel=0.02)


def test_nothing_is_added_without_a_normal_or_a_covariance() -> None:
    points, normal = wall(40_000)
    for variance, known in ((variance_of(), normal), (variance_of(depth_scale=0.01), 0.0 * normal)):
        variance.add(points, known, CameraMotion.at_rest(CAMERA))
        assert at(variance, (WALL_X_M, 2.0, 1.0)) == 0.0
    variance = variance_of(depth_scale=0.01)
    variance.add(points, normal, CameraMotion.at_rest(CAMERA))
    variance.clear()
    assert at(variance, (WALL_X_M, 2.0, 1.0)) == 0.0


def test_the_calibrated_measure_ranks_what_the_camera_may_be_wrong_about() -> None:
    agreement, variance = MeasuredAgreement(LOW, HIGH), variance_of(offset_z_m=0.05)
    near, normal = wall(STRIDE * 10_000)
    floor = near[:, [1, 2, 0]] * np.array([1.0, 1.0, 0.0], dtype=np.float32)
    up: FloatArray = np.tile([0.0, 0.0, 1.0], (len(floor), 1))
    for points, facing in ((near, normal), (floor, up.astype(np.float32))):
        agreement.add(points, facing, np.full(len(points), 0.001, dtype=np.float32))
        variance.add(points, facing, CameraMotion.at_rest(CAMERA))
    both = np.array([[WALL_X_M, 2.0, 1.0], [2.0, 1.0, 0.0]], dtype=np.float32)
    assert np.ptp(agreement.at(both)) < 1e-4
    wall_first = CalibratedAgreement(agreement, variance).at(both)
    assert wall_first[0] > 10.0 * wall_first[1]
