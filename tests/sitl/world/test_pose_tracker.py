from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sitl.geometry import transform
from sitl.world.pose_tracker import PoseRecord, SimulatedTracker

F64 = NDArray[np.float64]
ATTITUDE = Rotation.from_rotvec((0.1, -0.2, 1.3))
W, X, Y, Z = ATTITUDE.as_quat(scalar_first=True).tolist()
BODY = ((1.0, -2.0, 0.7), (W, X, Y, Z))


def run(seed: int, duration_s: float, step_s: float = 0.01) -> list[tuple[float, PoseRecord]]:
    poses = SimulatedTracker(seed)
    times = np.arange(0.0, duration_s, step_s)
    return [(float(now), record) for now in times for record in poses.step(float(now), *BODY)]


def errors(records: list[tuple[float, PoseRecord]]) -> F64:
    """Return position (m) and rotation-vector (rad) errors (N, 6)."""
    position = np.array([r.position_m for _, r in records]) - BODY[0]
    quats = np.array([r.quat_wxyz for _, r in records])
    rotation = (Rotation.from_quat(quats[:, [1, 2, 3, 0]]) * ATTITUDE.inv()).as_rotvec()
    return np.hstack([position, rotation])


def test_rate_delay_and_order() -> None:
    records = run(0, 120.0, 0.002)
    stamps = np.array([r.stamp_s for _, r in records])
    delay = np.array([now for now, _ in records]) - stamps
    assert len(stamps) == pytest.approx(120 * 15, abs=3)
    assert (np.diff(stamps) > 0).all()
    np.testing.assert_allclose(np.diff(stamps), 1 / 15, atol=0.0025)
    assert delay.mean() == pytest.approx(0.060, abs=0.004)
    assert delay.std() == pytest.approx(0.020, abs=0.004)
    assert delay.min() > 0.0099


def test_slow_calls_do_not_cluster_captures() -> None:
    stamps = np.array([r.stamp_s for _, r in run(0, 10.0, 0.2)])
    np.testing.assert_allclose(np.diff(stamps), 0.2, atol=1e-9)


def test_the_drift_starts_at_zero_and_grows_to_its_stated_size() -> None:
    first, late = [], []
    for seed in range(150):
        poses = SimulatedTracker(seed)
        records = [record for now in (0.0, 1e3, 1e3 + 1) for record in poses.step(now, *BODY)]
        first += [(0.0, r) for r in records if r.stamp_s == 0.0]
        late += [(0.0, r) for r in records if r.stamp_s == 1e3]
    white = errors(first)
    both = errors(late)
    np.testing.assert_allclose(white[:, :3].std(), 0.002, rtol=0.15)
    np.testing.assert_allclose(white[:, 3:].std(), math.radians(0.1), rtol=0.15)
    np.testing.assert_allclose(both[:, :3].std(), math.hypot(0.01, 0.002), rtol=0.15)
    np.testing.assert_allclose(both[:, 3:].std(), math.hypot(math.radians(0.3), math.radians(0.1)), rtol=0.15)
    np.testing.assert_allclose(late[0][1].variance[:3], 0.01**2 + 0.002**2)


def test_the_drift_has_a_time_constant_of_twenty_seconds() -> None:
    series = np.hstack([errors(run(seed, 400.0, 1 / 15))[:5990, :3] for seed in range(6)])
    lag = 15 * 20
    lagged = (series[lag:] * series[:-lag]).mean() / (series**2).mean()
    assert lagged == pytest.approx(math.exp(-1) * 0.96, abs=0.15)


def test_equal_seeds_give_equal_streams() -> None:
    np.testing.assert_array_equal(errors(run(5, 5.0)), errors(run(5, 5.0)))
    assert (errors(run(5, 5.0)) != errors(run(6, 5.0))[: len(run(5, 5.0))]).any()


def test_pose_algebra_agrees_with_scipy() -> None:
    rng = np.random.default_rng(0)
    for rotvec in rng.normal(0, 2, (50, 3)):
        expected = Rotation.from_rotvec(rotvec)
        matrix = transform.rotation_from_quat(expected.as_quat(scalar_first=True))
        np.testing.assert_allclose(matrix, expected.as_matrix(), atol=1e-12)
        pose = transform.rigid(matrix, rotvec)
        np.testing.assert_allclose(transform.inverse(pose) @ pose, np.eye(4), atol=1e-12)
    camera = transform.body_from_camera((0.1, 0, 0), math.radians(15))
    np.testing.assert_allclose(camera[:3, 2], (math.cos(math.radians(15)), 0, -math.sin(math.radians(15))))
    assert np.linalg.det(camera[:3, :3]) == pytest.approx(1.0)
