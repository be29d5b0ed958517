from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from uav_recon.evaluation.trajectory_error import (
    aligned,
    path_lengths_m,
    position_errors_m,
    relative_errors,
    rotation_angles_rad,
    scale_of,
    timed_errors_m,
    trajectory_error,
)
from uav_recon.types.frames import FloatArray

SEEDS = st.integers(0, 2**32 - 1)


def random_pose(rng: np.random.Generator) -> FloatArray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    pose[:3, 3] = rng.uniform(-5, 5, 3)
    return pose


def walk(rng: np.random.Generator, count: int = 200) -> FloatArray:
    """Return a random walk (count, 4, 4) with steps of about 4 cm that turns slowly."""
    poses = [random_pose(rng)]
    for _ in range(count - 1):
        step = np.eye(4)
        step[:3, :3] = Rotation.from_rotvec(rng.normal(0, 0.03, 3)).as_matrix()
        step[:3, 3] = [0.04, *rng.normal(0, 0.01, 2)]
        poses.append(poses[-1] @ step)
    return np.array(poses)


def noisy(poses: FloatArray, rng: np.random.Generator, metres: float, rad: float) -> FloatArray:
    out = poses.copy()
    for pose in out:
        pose[:3, 3] += rng.normal(0, metres, 3)
        pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(rng.normal(0, rad, 3)).as_matrix()
    return out


@given(SEEDS)
@settings(max_examples=40, deadline=None)
def test_alignment_is_that_of_an_independent_library(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = rng.uniform(-3, 3, (30, 3))
    estimate = truth @ random_pose(rng)[:3, :3].T + rng.uniform(-9, 9, 3) + rng.normal(0, 0.1, (30, 3))
    found = aligned(estimate, truth)
    rotation, distance = Rotation.align_vectors(truth - truth.mean(axis=0), estimate - estimate.mean(axis=0))
    assert found.rotation() == pytest.approx(rotation.as_matrix(), abs=1e-9)
    left = np.linalg.norm(found.apply(estimate) - truth)
    assert left == pytest.approx(distance, rel=1e-9)
    assert np.linalg.det(found.rotation()) == pytest.approx(1.0)


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_alignment_is_never_a_reflection(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = rng.uniform(-3, 3, (30, 3)) * [1.0, 1.0, 0.05]
    estimate = (truth * [1.0, 1.0, -1.0]) @ random_pose(rng)[:3, :3].T
    found = aligned(estimate, truth)
    rotation, _ = Rotation.align_vectors(truth - truth.mean(axis=0), estimate - estimate.mean(axis=0))
    assert found.rotation() == pytest.approx(rotation.as_matrix(), abs=1e-9)


@given(SEEDS)
@settings(max_examples=30, deadline=None)
def test_errors_do_not_depend_on_the_frames(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = walk(rng)
    estimate = noisy(truth, rng, 0.02, 0.01)
    one = trajectory_error(estimate, truth)
    other = trajectory_error(random_pose(rng) @ estimate, random_pose(rng) @ truth)
    for name in ("ate_m", "ate_max_m", "rotation_rad", "drift", "drift_median", "drift_p95", "drift_radpm", "length_m"):
        assert getattr(other, name) == pytest.approx(getattr(one, name), rel=1e-6), name


@given(SEEDS)
@settings(max_examples=20, deadline=None)
def test_a_true_trajectory_in_another_frame_has_no_error(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = walk(rng)
    found = trajectory_error(random_pose(rng) @ truth, truth)
    assert found.ate_max_m < 1e-9
    assert found.rotation_rad < 1e-7
    assert found.drift < 1e-9
    assert found.drift_radpm < 1e-7


@given(st.floats(0.01, 0.2))
@settings(max_examples=20, deadline=None)
def test_a_scale_error_is_not_aligned_away(share: float) -> None:
    truth = np.tile(np.eye(4), (101, 1, 1))
    truth[:, 0, 3] = np.linspace(0.0, 10.0, 101)
    estimate = truth.copy()
    estimate[:, 0, 3] *= 1.0 + share
    found = trajectory_error(estimate, truth)
    spread = truth[:, 0, 3].std()
    assert found.ate_m == pytest.approx(share * spread, rel=1e-9)
    assert found.drift == pytest.approx(share, rel=1e-9)
    assert found.length_m == pytest.approx(10.0)


def test_a_turn_rate_error_is_the_drift_of_rotation() -> None:
    truth = np.tile(np.eye(4), (101, 1, 1))
    truth[:, 0, 3] = np.linspace(0.0, 10.0, 101)
    estimate = truth.copy()
    for pose in estimate:
        pose[:3, :3] = Rotation.from_euler("z", 0.01 * pose[0, 3]).as_matrix()
    assert trajectory_error(estimate, truth).drift_radpm == pytest.approx(0.01, rel=1e-6)


def test_pairs_are_metres_of_path_apart_not_metres_of_distance() -> None:
    truth = np.tile(np.eye(4), (41, 1, 1))
    truth[:, 0, 3] = np.concatenate([np.linspace(0, 1, 21), np.linspace(0.95, 0, 20)])  # there and back
    path_m = path_lengths_m(truth[:, :3, 3])
    estimate = truth.copy()
    estimate[40, :3, 3] += [0.0, 0.1, 0.0]
    assert path_m[-1] == pytest.approx(2.0)
    drift, _ = relative_errors(estimate, truth, path_m, 1.94)
    assert len(drift) == 2  # from the first two poses
    assert drift.tolist() == pytest.approx([0.0, 0.1 / 1.95])


def test_the_path_shorter_than_the_drift_length_has_no_drift() -> None:
    truth = np.tile(np.eye(4), (5, 1, 1))
    truth[:, 0, 3] = np.linspace(0, 1, 5)
    truth[:, 1, 3] = [0, 0.1, 0, 0.1, 0]
    assert np.isnan(trajectory_error(truth, truth).drift)


@given(st.floats(0.0, np.pi), SEEDS)
@settings(max_examples=50, deadline=None)
def test_angles_are_exact_near_zero_and_pi(angle: float, seed: int) -> None:
    axis = np.random.default_rng(seed).standard_normal(3)
    rotation = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
    assert rotation_angles_rad(rotation[None])[0] == pytest.approx(angle, abs=1e-7)


def test_position_errors_are_those_of_each_pose() -> None:
    truth = walk(np.random.default_rng(3))
    estimate = truth.copy()
    estimate[50, 2, 3] += 1.0
    errors = position_errors_m(estimate, truth)
    assert int(np.argmax(errors)) == 50
    assert errors[50] == pytest.approx(1.0, abs=0.03)


def test_two_poses_cannot_be_aligned() -> None:
    with pytest.raises(ValueError, match="at least 3"):
        aligned(np.zeros((2, 3)), np.zeros((2, 3)))
    with pytest.raises(ValueError, match="got"):
        aligned(np.zeros((4, 3)), np.zeros((5, 3)))


@given(seed=SEEDS, scale=st.floats(0.5, 2.0))
def test_the_scale_of_a_moved_and_stretched_walk_is_found(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    true = walk(rng, 60)[:, :3, 3]
    moved = random_pose(rng)
    assert scale_of(true @ moved[:3, :3].T / scale + moved[:3, 3], true) == pytest.approx(scale, rel=1e-6)


def test_errors_over_a_time_are_those_of_the_relative_poses() -> None:
    """A trajectory that is one per cent too long, sampled at uneven times; the pairs are those nearest to the time."""
    stamp_s = np.array([0.0, 0.1, 0.2, 0.31, 0.4, 0.5, 0.6, 1.3])
    true = np.tile(np.eye(4), (len(stamp_s), 1, 1))
    true[:, 0, 3] = 2.0 * stamp_s
    estimate = true.copy()
    estimate[:, 0, 3] *= 1.01
    expected = [0.02 * step for step in (0.31, 0.3, 0.3, 0.29)]
    np.testing.assert_allclose(timed_errors_m(estimate, true, stamp_s, 0.3), expected, atol=1e-12)
    assert not len(timed_errors_m(estimate, true, stamp_s, 5.0))
