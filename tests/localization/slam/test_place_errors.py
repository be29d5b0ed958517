"""Joint covariance of body and keyframes, against a Kalman filter of one large state."""

from __future__ import annotations

import numpy as np
import pytest

from uav_recon.localization.slam import place_errors
from uav_recon.localization.slam.place_errors import PlaceErrors, Update, worst_variances
from uav_recon.types.frames import FloatArray, IntArray

STEP_S = 0.1
PLACED_M = 0.01
SEEN_M = 0.003


class Dense:
    """Oracle: place and velocity, two earlier places, and keyframes, in one state (12 + 3 N,)."""

    def __init__(self, state: FloatArray) -> None:
        self.mean = np.zeros(12)
        self.covariance = 1e-6 * np.eye(12)
        self.covariance[:6, :6] = state
        self.lag = 0

    def transform(self, matrix: FloatArray, noise: FloatArray) -> None:
        self.mean, self.covariance = matrix @ self.mean, matrix @ self.covariance @ matrix.T + noise

    def predict(self, transition: FloatArray, noise: FloatArray) -> None:
        whole, added = np.eye(len(self.mean)), np.zeros((len(self.mean), len(self.mean)))
        whole[:6, :6], added[:6, :6] = transition, noise
        self.transform(whole, added)

    def clone(self) -> None:
        whole = np.vstack((np.eye(len(self.mean)), np.eye(3, len(self.mean))))
        noise = np.zeros((len(whole), len(whole)))
        noise[-3:, -3:] = PLACED_M**2 * np.eye(3)
        self.transform(whole, noise)

    def mark_lag(self) -> None:
        whole = np.eye(len(self.mean))
        whole[6 + 3 * self.lag : 9 + 3 * self.lag] = whole[:3]
        self.transform(whole, np.zeros_like(self.covariance))
        self.lag = 1 - self.lag

    def see(self, keyframe: int, way_m: FloatArray) -> None:
        rows = np.zeros((3, len(self.mean)))
        rows[:, :3], rows[:, 12 + 3 * keyframe : 15 + 3 * keyframe] = np.eye(3), -np.eye(3)
        gain = self.covariance @ rows.T @ np.linalg.inv(rows @ self.covariance @ rows.T + SEEN_M**2 * np.eye(3))
        self.mean = self.mean + gain @ (way_m - rows @ self.mean)
        self.covariance = self.covariance - gain @ rows @ self.covariance


def _seen(errors: PlaceErrors, number: int, off_m: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Arguments of updated(): correction and covariance of the joint places by the way to a keyframe. off_m (3,): too short."""
    numbers = np.array([number])
    joint, rows = errors.joint(numbers), np.hstack((np.eye(3), np.zeros((3, 3)), -np.eye(3)))
    gain = joint @ rows.T @ np.linalg.inv(rows @ joint @ rows.T + SEEN_M**2 * np.eye(3))
    return numbers, gain @ off_m, joint - gain @ rows @ joint


def _start() -> FloatArray:
    return np.diag([1e-6] * 3 + [0.05**2] * 3)


def _motion() -> tuple[FloatArray, FloatArray]:
    """Return the transition (6, 6) and the noise (6, 6) of a step."""
    transition = np.eye(6)
    transition[:3, 3:] = STEP_S * np.eye(3)
    return transition, np.diag([0.004**2] * 3 + [0.05**2] * 3)


def _flown(seed: int, frames: int = 60) -> tuple[PlaceErrors, Dense, FloatArray, FloatArray]:
    """Fly in both; return also the means (6,), (3 N,) of the estimator under test."""
    random, (transition, noise) = np.random.default_rng(seed), _motion()
    errors, dense, state, places = PlaceErrors.start(_start()), Dense(_start()), np.zeros(6), np.zeros((0, 3))
    for frame in range(frames):
        state = transition @ state
        errors = errors.predicted(transition @ errors.state @ transition.T + noise, transition)
        dense.predict(transition, noise)
        if frame and frame % 3:
            keyframe = int(random.integers(max(errors.count - 4, 0), errors.count))
            way_m = 0.05 * random.standard_normal(3)
            off_m = way_m - (state[:3] - places[keyframe])
            errors, corrected, moved_m, _ = errors.updated(*_seen(errors, keyframe, off_m))
            state, places = state + corrected, places + moved_m
            dense.see(keyframe, way_m)
        if frame % 5 == 0:
            errors, places = errors.with_keyframe(PLACED_M), np.vstack((places, state[:3]))
            dense.clone()
        if frame % 10 == 9:
            errors = errors.with_lag()
            dense.mark_lag()
    return errors, dense, state, places.ravel()


@pytest.mark.parametrize("seed", range(4))
def test_means_and_covariances_are_those_of_one_large_kalman_filter(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(place_errors, "_LEAST_GAIN", -1.0)
    errors, dense, state, places = _flown(seed)
    assert errors.count == 12
    np.testing.assert_allclose(state, dense.mean[:6], atol=1e-9)
    np.testing.assert_allclose(places, dense.mean[12:], atol=1e-9)
    np.testing.assert_allclose(errors.body, dense.covariance[:12, :12], atol=1e-11)
    np.testing.assert_allclose(errors.cross, dense.covariance[:12, 12:], atol=1e-11)
    np.testing.assert_allclose(errors.places, dense.covariance[12:, 12:], atol=1e-11)


@pytest.mark.parametrize("seed", range(4))
def test_keyframes_that_stay_where_they_are_cost_little_and_claim_nothing(seed: int) -> None:
    errors, dense, state, _ = _flown(seed, 120)
    assert np.diagonal(errors.places - dense.covariance[12:, 12:]).min() > -1e-9
    np.testing.assert_allclose(np.diagonal(errors.state)[:3], np.diagonal(dense.covariance)[:3], rtol=0.05)
    np.testing.assert_allclose(state[:3], dense.mean[:3], atol=0.003)


@pytest.mark.parametrize("seed", range(4))
def test_of_many_keyframes_those_move_that_an_update_moves_most(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The time of an update is bounded; the others claim no less than one large filter does."""
    monkeypatch.setattr(place_errors, "_MOST_MOVED", 6)
    errors, dense, *_ = _flown(seed, 120)
    assert errors.count > 12
    assert np.diagonal(errors.places - dense.covariance[12:, 12:]).min() > -1e-9
    assert np.linalg.eigvalsh(errors.places).min() > -1e-12
    after, _, moved_m, update = errors.updated(*_seen(errors, 0, np.array([0.02, 0.0, 0.0])))
    length_m = np.linalg.norm(moved_m, axis=1)
    assert np.count_nonzero(length_m) == 6 == len(update.elements) // 3
    assert after.count == errors.count


def test_an_update_can_be_undone_and_done_again() -> None:
    errors, *_ = _flown(1)
    before = errors.places.copy()
    after, _, _, update = errors.updated(*_seen(errors, 3, np.array([0.01, 0.0, 0.0])))
    changed = after.places.copy()
    assert np.abs(changed - before).max() > 1e-6
    errors.undo(update)
    np.testing.assert_allclose(errors.places, before, atol=1e-15)
    errors.redo(update)
    np.testing.assert_allclose(after.places, changed, atol=1e-15)
    assert isinstance(update, Update)


def test_a_keyframe_that_was_just_taken_says_nothing_of_the_error_that_it_shares() -> None:
    """The place is off by 20 cm with a velocity that belongs to it: a new keyframe must confirm neither."""
    transition, noise = _motion()
    errors = PlaceErrors.start(np.diag([1e-6] * 3 + [0.2**2] * 3))
    for _ in range(10):
        errors = errors.predicted(transition @ errors.state @ transition.T + 0.0 * noise, transition)
    sigma_m, sigma_mps = np.sqrt(errors.state[0, 0]), np.sqrt(errors.state[3, 3])
    assert sigma_m == pytest.approx(0.2, rel=0.01)
    errors = errors.with_keyframe(PLACED_M)
    errors, *_ = errors.updated(*_seen(errors, 0, np.zeros(3)))
    assert np.sqrt(errors.state[0, 0]) > 0.95 * sigma_m
    assert np.sqrt(errors.state[3, 3]) > 0.95 * sigma_mps
    joint = errors.joint(np.array([0]))
    way = joint[:3, :3] - joint[:3, 6:] - joint[6:, :3] + joint[6:, 6:]
    assert np.sqrt(np.diagonal(way).max()) < 0.004


def test_an_old_keyframe_in_view_again_corrects_body_and_keyframes_since() -> None:
    transition, noise = _motion()
    errors = PlaceErrors.start(_start()).with_keyframe(PLACED_M)
    for frame in range(40):
        errors = errors.predicted(transition @ errors.state @ transition.T + noise, transition)
        if frame % 10 == 9:
            errors = errors.with_keyframe(PLACED_M).with_lag()
    assert np.sqrt(errors.variance[4, 0]) > 0.3
    off_m = np.array([0.3, 0.0, 0.0])
    after, corrected, moved_m, _ = errors.updated(*_seen(errors, 0, off_m))
    np.testing.assert_allclose(corrected[:3], off_m, atol=0.01)
    assert abs(moved_m[0, 0]) < 0.01 < moved_m[1, 0] < moved_m[2, 0] < moved_m[3, 0] < moved_m[4, 0] < 0.32
    assert np.sqrt(after.variance.max()) < 0.13


def test_the_place_against_that_lately_is_uncertain_by_the_motion_since() -> None:
    transition, noise = _motion()
    errors = PlaceErrors.start(np.diag([0.5**2] * 3 + [0.0] * 3)).with_lag().with_lag()
    for _ in range(5):
        errors = errors.predicted(transition @ errors.state @ transition.T + noise, transition)
    expected = np.zeros((6, 6))
    for _ in range(5):
        expected = transition @ expected @ transition.T + noise
    np.testing.assert_allclose(errors.against_lag(), expected, atol=1e-9)


def test_the_worst_variances_are_those_of_the_ways() -> None:
    root = np.random.default_rng(6).standard_normal((12, 15))
    joint = root @ root.T
    ways = [np.hstack((np.eye(3), np.zeros((3, 3 * m)), -np.eye(3), np.zeros((3, 6 - 3 * m)))) for m in range(3)]
    expected = [np.linalg.eigvalsh(way @ joint @ way.T)[-1] for way in ways]
    np.testing.assert_allclose(worst_variances(joint), expected, rtol=1e-9)
