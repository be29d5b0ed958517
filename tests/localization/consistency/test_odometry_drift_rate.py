"""Rooms of boxes, seen from poses that are right or creep; what stands there is looked at from all sides."""

from __future__ import annotations

import numpy as np
import pytest
from textured_room import BARE, CAMERA, Paint, camera_at, depth_of, frame_of, moved, plaster, rgb_of

from uav_recon.localization.consistency.odometry_drift_rate import DriftRateEstimator
from uav_recon.localization.consistency.planar_patches import error_rows, normal_equations, patches
from uav_recon.types.camera import body_from_camera
from uav_recon.types.camera_calibration import CameraMotion
from uav_recon.types.frames import AnyArray, Float32Array, FloatArray
from uav_recon.types.pose import Pose

PERIOD_S = 1.0 / 6.0
STILL = CameraMotion.at_rest(Pose.identity())
SMALL_M = np.array([[-3.0, -2.0, 0.0], [3.0, 2.5, 2.6]])
LARGE_M = np.array([[-9.0, -9.0, 0.0], [4.7, 9.0, 9.0]])
CABINET_M = np.array([[1.5, 0.7, 0.0], [2.0, 1.2, 2.6]])
PARTITION_M = np.array([[0.0, -5.0, 0.0], [0.11, 0.8, 9.0]])
OPEN_M, BOARD_M = np.array([[-20.0, -20.0, -20.0], [20.0, 20.0, 20.0]]), np.array([[2.0, -19.0, -19.0], [3.0, 19.0, 19.0]])


class Flight:
    """At 6 Hz; odom is off by a velocity from begins_s on, and tilted. paint: what there is is bare without."""

    def __init__(
        self,
        velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
        begins_s: float = 0.0,
        paint: Paint | None = None,
        tilt_rad: float = 0.0,
    ) -> None:
        self.estimator = DriftRateEstimator()
        self.n = 0
        self.peak_mps = 0.0
        self.excess = 0.0
        self.reported = False
        self._paint = paint
        self._velocity = np.array(velocity)
        self._begins_s = begins_s
        self._tilt_rad = np.array([0.0, tilt_rad, 0.0])
        self._before: Pose | None = None

    @property
    def now_s(self) -> float:
        return self.n * PERIOD_S

    def see(self, camera: Pose, room_m: FloatArray = SMALL_M, *boxes_m: FloatArray, jump_m: float = 0.0) -> None:
        by_m = self._velocity * max(self.now_s - self._begins_s, 0.0) + (jump_m, 0.0, 0.0)
        rgb = BARE if self._paint is None else rgb_of(camera, self._paint, room_m, *boxes_m, seed=self.n)
        frame = frame_of(self.now_s, depth_of(camera, room_m, *boxes_m, seed=self.n), rgb)
        place_m = camera.translation_m
        tilt = Pose.from_rotation_vector(self._tilt_rad, place_m) @ Pose.from_yaw(0.0, -place_m)
        reported, before = moved(tilt @ camera, by_m), self._before
        self._before = reported
        self.estimator.update(
            frame, CameraMotion.at_rest(reported) if before is None else CameraMotion.between(before, reported, PERIOD_S)
        )
        self.excess = max(self.excess, self.estimator.excess)
        self.reported |= self.estimator.drifts
        self.peak_mps = max(self.peak_mps, float(np.linalg.norm(self.estimator.velocity_mps)))
        self.n += 1

    def look_about(self, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD_S)):
            self.see(camera_at(0.3 * np.sin(0.07 * self.n), 0.0, 1.2, 0.5 * np.sin(0.1 * self.n)), SMALL_M, CABINET_M)


@pytest.mark.parametrize("way", [(0.05, 0.0, 0.0), (0.0, -0.05, 0.0), (0.0, 0.0, 0.05), (0.1, 0.0, 0.0)])
def test_what_creeps_is_reported_with_its_direction(way: tuple[float, float, float]) -> None:
    flight = Flight(way)
    flight.look_about(14.0)
    np.testing.assert_allclose(flight.estimator.velocity_mps, way, atol=0.35 * float(np.linalg.norm(way)))


def test_what_stays_does_not_creep() -> None:
    flight = Flight()
    flight.look_about(20.0)
    assert flight.peak_mps < 0.005
    assert not flight.reported


def test_going_round_a_partition_is_no_creep() -> None:
    """As it was in two generated flats: what stands where its one side was is its other side, as thick as a drift is long."""
    flight = Flight()
    for n in range(60):
        turned = np.pi * np.clip((n - 20) / 20, 0.0, 1.0)
        flight.see(camera_at(-0.9 * np.cos(turned), 0.8 + 0.6 * np.sin(turned), 1.2, -0.6 - turned), LARGE_M, PARTITION_M)
    assert flight.peak_mps < 0.005


def test_a_wall_far_off_tells_beside_a_floor_that_is_near() -> None:
    """As it was over a hall's floor: at 4 m the noise of a few pixels made normals of a wall that were none."""
    flight = Flight((0.05, 0.0, 0.0), begins_s=6.0)
    for n in range(72):
        flight.see(camera_at(0.2, 0.02 * n, 1.2, 0.0), LARGE_M)
    assert flight.estimator.velocity_mps[0] == pytest.approx(0.045, abs=0.012)


@pytest.mark.parametrize(("drift_mps", "reported"), [(0.0, False), (0.02, False), (0.06, True)])
def test_a_drift_along_the_way_is_reported_once_the_scale_of_depth_cannot_explain_it(drift_mps: float, reported: bool) -> None:
    """Straight towards a wall at 0.5 m/s, a camera whose depth is 4 % too large sees the same as a drift of 0.02 m/s."""
    flight = Flight((drift_mps, 0.0, 0.0), begins_s=6.0)
    for n in range(96):
        flight.see(camera_at(-4.5 + 0.5 * PERIOD_S * n, 0.02 * n, 1.2, 0.0), LARGE_M)
    assert flight.reported is reported


def test_along_a_bare_wall_nothing_can_be_measured() -> None:
    flight = Flight((0.05, 0.05, 0.0))
    for _ in range(84):
        flight.see(camera_at(0.0, 0.0, 1.2, 0.0), OPEN_M, BOARD_M)
    np.testing.assert_allclose(flight.estimator.velocity_mps, (0.045, 0.0, 0.0), atol=0.006)


def test_along_a_wall_its_paint_tells() -> None:
    flight = Flight((0.05, 0.05, 0.0), paint=plaster)
    for n in range(84):
        flight.see(camera_at(0.0, 0.05 * n, 1.2, 0.02 * n), OPEN_M, BOARD_M)
    np.testing.assert_allclose(flight.estimator.velocity_mps, (0.045, 0.037, 0.0), atol=0.008)


def test_paint_that_stays_does_not_creep() -> None:
    flight = Flight(paint=plaster)
    flight.look_about(20.0)
    assert flight.peak_mps < 0.004


def test_what_walks_by_does_not_pull() -> None:
    """As broad as a third of the picture, painted as the wall is."""
    flight = Flight(paint=plaster)
    for n in range(60):
        person_m = np.array([[1.2, -1.2, 0.0], [1.5, -0.7, 1.8]]) + np.array([0.0, 0.03 * n, 0.0])
        flight.see(camera_at(0.0, 0.0, 1.2, 0.0), SMALL_M, person_m)
    assert flight.peak_mps < 0.01


def test_views_of_the_first_three_seconds_tell_nothing() -> None:
    """On the pad the filter settles by some centimetres."""
    flight = Flight((0.05, 0.0, 0.0))
    flight.look_about(3.1)
    assert flight.peak_mps == 0.0
    flight.look_about(2.0)
    assert flight.peak_mps > 0.0


def test_a_reported_drift_fades_and_a_new_odom_begins_again() -> None:
    flight = Flight((0.05, 0.0, 0.0))
    flight.look_about(12.0)
    for _ in range(150):
        flight.estimator.update(frame_of(flight.now_s, np.full((120, 212), np.nan, np.float32)), STILL)
        flight.n += 1
    assert np.linalg.norm(flight.estimator.velocity_mps) < 0.01
    flight = Flight((0.05, 0.0, 0.0))
    flight.look_about(12.0)
    flight.estimator.forget()
    assert not flight.estimator.velocity_mps.any()


def test_what_the_last_seconds_said_of_the_camera_is_taken_back() -> None:
    """A pose source was wrong and excluded; the camera is as it was."""
    flight = Flight((1.0, 0.0, 0.0), begins_s=12.0)
    flight.look_about(9.0)
    known = flight.estimator.calibration.summary()
    flight.look_about(3.0)
    flight.see(camera_at(0.0, 0.0, 1.2, 0.0), SMALL_M, CABINET_M)
    flight.look_about(0.5)
    wrong = flight.estimator.calibration.summary()
    flight.estimator.undo()
    assert not flight.estimator.velocity_mps.any()
    values = np.array([[value for _, value, _ in each] for each in (known, wrong, flight.estimator.calibration.summary())])
    assert np.abs(values[2] - values[0]).max() < 0.2 * np.abs(values[1] - values[0]).max()


def test_a_pause_counts_as_a_moment() -> None:
    flight = Flight()
    flight.look_about(4.0)
    flight.n += 12
    flight.see(camera_at(0.0, 0.0, 1.2, 0.0), jump_m=0.05)
    assert flight.peak_mps < 0.015


def test_an_odom_that_is_tilted_does_not_creep() -> None:
    """As it was in a gallery: on the way home at 1 m/s the floor that was far lay lower once it was near, by 0.6 degrees."""
    flight = Flight(tilt_rad=0.02)
    for n in range(60):
        flight.see(camera_at(-8.5 + 0.15 * n, 0.0, 1.2, 0.0), LARGE_M)
    assert not flight.reported


def _compared(
    before: Pose, then: AnyArray, depth_m: Float32Array, here: Pose, expected: FloatArray
) -> tuple[int, int, AnyArray, AnyArray]:
    """The normal equations for the drift alone, of images one second apart; expected: (3,) m/s."""
    state, rest = np.concatenate([expected, np.zeros(9)]), np.zeros(3)
    rows = error_rows(then, before.rotation(), before.translation_m, rest, rest)
    camera = CAMERA, here.rotation(), here.translation_m
    seen, within, held, pulled = normal_equations(then, rows, depth_m, *camera, rest, rest, 1.0, state)
    return seen, within, held[:3, :3], pulled[:3]


def _patches(camera: Pose, depth_m: Float32Array) -> AnyArray:
    found: AnyArray = patches(depth_m, CAMERA, camera.rotation(), camera.translation_m)
    return found


def test_a_patch_lies_on_its_surface_and_looks_away_from_thecamera_at() -> None:
    here = camera_at(-0.3, 0.0, 1.2, 0.3)
    found = _patches(here, depth_of(here, LARGE_M))
    wall, floor = LARGE_M[1, 0] - found[:, 0], found[:, 2]
    assert len(found) > 250
    assert np.quantile(np.minimum(abs(wall), abs(floor)), 0.99) < 0.15
    assert np.median(found[abs(wall) < 0.15, 3]) > 0.97
    assert np.median(found[abs(floor) < 0.05, 5]) < -0.99


def test_the_rim_of_something_is_no_patch() -> None:
    here = camera_at(0.0, 0.9, 1.2, 0.0)
    found = _patches(here, depth_of(here, SMALL_M, CABINET_M))
    assert len(found) > 200
    planes_m = [*SMALL_M[:, 0], *SMALL_M[:, 1], *SMALL_M[:, 2], *CABINET_M[:, 0], *CABINET_M[:, 1]]
    axes = [0, 0, 1, 1, 2, 2, 0, 0, 1, 1]
    off_m = np.min([abs(found[:, axis] - at_m) for axis, at_m in zip(axes, planes_m, strict=True)], axis=0)
    assert np.all(off_m < 0.1)


def test_the_other_face_of_a_board_is_another_surface() -> None:
    """As near to the first as a drift would bring it."""
    board_m = np.array([[0.0, -9.0, 0.0], [0.04, 9.0, 9.0]])
    before, behind = camera_at(-0.8, 0.0, 1.2, 0.0), camera_at(0.84, 0.0, 1.2, np.pi)
    then, depth_m = _patches(before, depth_of(before, LARGE_M, board_m)), depth_of(behind, LARGE_M, board_m, seed=1)
    _, _, held, _ = _compared(before, then, depth_m, behind, np.zeros(3))
    assert len(then) > 300
    assert held[0, 0] < 1.0


@pytest.mark.parametrize(("away_m", "weight"), [(1.5, 0.94), (3.0, 0.50), (4.5, 0.165)])
def test_what_is_far_counts_less(away_m: float, weight: float) -> None:
    """As it was in a hall: a few patches at 5 m, whose noise stays while their view is remembered, passed for creep."""
    here = Pose.from_yaw(0.0, np.array([2.0 - away_m, 0.0, 1.2])) @ body_from_camera(np.zeros(3), 0.0)
    then, depth_m = _patches(here, depth_of(here, OPEN_M, BOARD_M)), depth_of(here, OPEN_M, BOARD_M, seed=1)
    _, within, held, _ = _compared(here, then, depth_m, here, np.zeros(3))
    assert within > 100
    assert held[0, 0] / within == pytest.approx(weight, abs=0.05)


@pytest.mark.parametrize(("shift_m", "expected_m", "explained"), [(0.0, 0.0, True), (0.5, 0.5, True), (0.5, 0.0, False)])
def test_what_lies_off_by_more_than_is_expected_does_not_pull(shift_m: float, expected_m: float, explained: bool) -> None:
    """Straight down on a floor."""
    here = Pose.from_yaw(0.0, np.array([0.0, 0.0, 1.2])) @ body_from_camera(np.zeros(3), 1.5)
    shifted, up = moved(here, np.array([0.0, 0.0, shift_m])), np.array([0.0, 0.0, expected_m])
    then, depth_m = _patches(here, depth_of(here, LARGE_M)), depth_of(here, LARGE_M, seed=1)
    seen, within, held, pulled = _compared(here, then, depth_m, shifted, up)
    assert seen > 100
    assert (within > 0.95 * seen) if explained else (within == 0)
    if explained:
        assert pulled[2] / held[2, 2] == pytest.approx(shift_m, abs=0.01)
