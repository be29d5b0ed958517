"""Frames of the outside world with camera errors: what instant they show, when they come, and which are lost."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from sitl.autopilots.base_autopilot import VehicleTruth
from sitl.camera.camera_errors import FILE_NAME, CameraErrors, MountErrors, TimingErrors
from sitl.camera.d435i import SMALL_COLOUR_SPEC, Model, SimulatedD435i
from sitl.geometry.quaternion import from_yaw
from sitl.outside_world import OutsideWorld
from sitl.scene.rasterizer import Renderer
from sitl.world.step_sizes import COARSE_STEPS, FINE_STEPS, StepSizes

F64 = NDArray[np.float64]
START_S = 1000.0
WALL_M = 3.0
STRIPE_M = 0.02


class Moving:
    """Vehicle at a constant velocity (m/s) from the origin, level, looking along x."""

    failsafes: tuple[str, ...] = ()
    setpoint_arrivals_s: tuple[float, ...] = ()

    def __init__(self, velocity: tuple[float, float], gimbal_rate: float = 0.0) -> None:
        self._velocity = velocity
        self._gimbal_rate = gimbal_rate
        self._now_s = START_S

    def step(self, now_s: float) -> None:
        self._now_s = now_s

    def truth(self) -> VehicleTruth:
        since_s, (vx, vy) = self._now_s - START_S, self._velocity
        return VehicleTruth(
            self._now_s, (vx * since_s, vy * since_s, 0.0), (vx, vy, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0),
            (0.0, 0.0, 9.8), self._gimbal_rate * since_s, False, "OFFBOARD",
        )  # fmt: skip


@dataclass
class Tape:
    """Frames with the time of their delivery, and inertial samples."""

    now_s: float = START_S
    frames: list[tuple[float, float, Any, Any]] = field(default_factory=list)
    imu: list[tuple[float, Any, Any]] = field(default_factory=list)

    def write_frame(self, stamp_s: float, depth_mm: Any, rgb: Any) -> None:
        self.frames.append((self.now_s, stamp_s, depth_mm, rgb))

    def write_imu(self, stamp_s: float, gyro: Any, force: Any) -> None:
        self.imu.append((stamp_s, gyro, force))


class NoPoses:
    def due(self, now_s: float) -> bool:
        return False


def scene() -> Renderer:
    """Return a black wall across everything, WALL_M before the body's origin, with a white upright stripe at y = 0."""
    y = (-30.0, 30.0, -STRIPE_M, STRIPE_M)
    corners = [[WALL_M - 0.001 * (k > 1), y[k], z] for k in range(4) for z in (-30.0, 30.0)]
    faces = np.array([[0, 1, 3], [0, 3, 2], [4, 5, 7], [4, 7, 6]], np.int32)
    rgb = np.repeat(np.array([0, 255], np.uint8), 4)[:, None].repeat(3, axis=1)
    return Renderer(np.array(corners, np.float32), faces, rgb)


def flown(
    flyer: Moving, errors: CameraErrors, seconds: float, model: Model = "fast", pace: StepSizes = FINE_STEPS,
    pitch: float | None = 0.0,
) -> Tape:  # fmt: skip
    """Return what a flight writes."""
    tape, camera = Tape(), SimulatedD435i(scene(), model, "none", errors=errors)
    world = OutsideWorld(*cast(Any, (flyer, camera, NoPoses(), None, tape, START_S, pitch, pace, errors)))
    for n in range(round(seconds / pace.iteration_s) + 1):
        tape.now_s = now_s = START_S + n * pace.iteration_s
        world.step(now_s)
        if world.frame_due(now_s):
            world.develop(world.begin_frame())
    return tape


@pytest.mark.parametrize("pace", [FINE_STEPS, COARSE_STEPS])
@pytest.mark.parametrize("age_s", [0.0, 0.031])
def test_frames_show_where_the_vehicle_was_before_their_stamp(age_s: float, pace: StepSizes) -> None:
    speed = 0.4
    errors = CameraErrors(3, timing=TimingErrors(age_s=age_s, jitter_s=0.005))
    tape = flown(Moving((speed, 0.0)), errors, 5.0, pace=pace)
    stamps = np.array([stamp_s for _, stamp_s, _, _ in tape.frames])
    depth_m = np.array([np.median(depth) for _, _, depth, _ in tape.frames]) * 1e-3
    ages_s = stamps - START_S - (WALL_M - 0.1 - depth_m) / speed
    ages_s = ages_s[1:]  # there is no pose before the first frame
    assert len(ages_s) >= 29
    assert np.median(ages_s) == pytest.approx(age_s, abs=0.003)
    assert 0.003 < ages_s.std() < 0.007


def test_colour_rows_are_read_one_after_the_other_some_time_after_depth() -> None:
    """The camera passes a stripe: the column that shows it, in each row, tells when the row was read."""
    speed, timing = 1.0, TimingErrors(age_s=0.020, colour_delay_s=0.015, readout_s=0.025)
    tape, f = flown(Moving((0.0, speed)), CameraErrors(timing=timing), 1.0, "small"), SMALL_COLOUR_SPEC.fx
    times = []
    for _, stamp_s, _, rgb in tape.frames[1:]:
        white = rgb[..., 0].astype(np.float64)
        columns = (white * np.arange(white.shape[1])).sum(axis=1) / white.sum(axis=1)
        sideways_m = (columns - SMALL_COLOUR_SPEC.cx) / f * (WALL_M - 0.1) - 0.015  # the colour imager is on the left
        times.append(sideways_m / speed - (stamp_s - START_S))
    rows = np.mean(times, axis=0)
    slope, middle = np.polyfit(np.linspace(-0.5, 0.5, len(rows)), rows, 1)
    assert slope == pytest.approx(0.025, abs=0.003)
    assert middle == pytest.approx(-0.020 + 0.015, abs=0.003)


def test_no_frame_comes_before_its_stamp_or_its_last_row_and_stamps_increase() -> None:
    for seed in range(6):
        errors = CameraErrors.drawn(seed)
        tape = flown(Moving((0.0, 0.0)), replace(errors, loss=CameraErrors().loss), 3.0)
        t = errors.timing
        waited_s = np.array([came_s - stamp_s for came_s, stamp_s, _, _ in tape.frames])
        assert (waited_s >= -1e-9).all()
        assert waited_s.max() <= max(t.colour_delay_s + 0.5 * t.readout_s - t.age_s, 0.0) + 3.0 * t.jitter_s + 0.01 + 1e-9
        assert (np.diff([stamp_s for _, stamp_s, _, _ in tape.frames]) > 0.1).all()
        assert len(tape.frames) >= 18


def test_the_angle_of_a_gimbal_is_that_of_the_exposure() -> None:
    """A gimbal that tilts at 0.5 rad/s down: the depth along the axis is that of the tilt 40 ms ago."""
    tape = flown(Moving((0.0, 0.0), 0.5), CameraErrors(timing=TimingErrors(age_s=0.04)), 1.0, pitch=None)
    _, stamp_s, depth_mm, _ = tape.frames[-1]
    pitch = 0.5 * (stamp_s - START_S - 0.04)
    height, width = depth_mm.shape
    assert np.mean(depth_mm[height // 2 - 1 : height // 2 + 1, width // 2]) == pytest.approx(2900.0 / np.cos(pitch), abs=4.0)


def test_the_poses_within_a_stall_of_the_simulator_are_those_of_the_inertial_samples() -> None:
    """At 8 m/s^2 the chord over a stall of 0.1 s is 10 mm from the path at its middle."""

    class Faster(Moving):
        def truth(self) -> VehicleTruth:
            since_s = self._now_s - START_S
            return replace(super().truth(), position=(4.0 * since_s**2, 0.0, 0.0))

    errors, tape = CameraErrors(timing=TimingErrors(age_s=0.05)), Tape()
    camera = SimulatedD435i(scene(), "fast", "none", errors=errors)
    world = OutsideWorld(*cast(Any, (Faster((0.0, 0.0)), camera, NoPoses(), None, tape, START_S, 0.0, FINE_STEPS, errors)))
    for now_s in (START_S, START_S + 0.16, START_S + 0.26):
        world.step(now_s)
        if world.frame_due(now_s):
            world.develop(world.begin_frame())
    _, stamp_s, depth_mm, _ = tape.frames[-1]
    assert stamp_s == START_S + 0.26
    assert np.median(depth_mm) == pytest.approx(2900.0 - 4000.0 * 0.21**2, abs=1.5)


def test_a_turned_camera_looks_and_measures_in_the_same_turned_axes() -> None:
    """Turned left by 60 degrees, depth, colour and IMU alike: the wall is twice as far, the stripe is out of the image."""
    tape, errors, turn = Tape(), CameraErrors(), from_yaw(np.pi / 3)
    camera = SimulatedD435i(scene(), "small", "none", errors=errors)
    straight = SimulatedD435i(scene(), "small", "none").capture(np.eye(4), 0.0)
    world = OutsideWorld(*cast(Any, (Pushed((0.0, 0.0)), camera, NoPoses(), None, tape, START_S, 0.0, COARSE_STEPS, errors)))
    world.turn_camera(turn)
    world.step(START_S)
    assert world.frame_due(START_S)
    world.develop(world.begin_frame())
    (_, _, depth_mm, rgb), (_, _, force) = tape.frames[-1], tape.imu[-1]
    height, width = depth_mm.shape
    mount_m = 0.1 * np.cos(np.pi / 3)  # the camera goes round the body's origin
    assert np.mean(depth_mm[height // 2, width // 2 - 1 : width // 2 + 1]) == pytest.approx(
        2000.0 * (WALL_M - mount_m), rel=0.02
    )
    assert straight[1].any() and not rgb.any()
    np.testing.assert_allclose(force, [0.5, -np.sqrt(0.75), 9.8], atol=1e-6)


class Pushed(Moving):
    """Vehicle whose accelerometer reads 1 m/s² ahead."""

    def truth(self) -> VehicleTruth:
        return replace(super().truth(), specific_force=(1.0, 0.0, 9.8))


def test_lost_frames_are_missing_from_the_stream() -> None:
    errors = CameraErrors(1, loss=replace(CameraErrors.drawn(1).loss, min_gap_s=2.0, max_gap_s=3.0))
    stamps = np.array([stamp_s for _, stamp_s, _, _ in flown(Moving((0.0, 0.0)), errors, 30.0, pace=COARSE_STEPS).frames])
    gaps = np.rint(np.diff(stamps) * 6.0)
    assert {1, 2} <= set(gaps) <= {1, 2, 3, 4, 5, 6}
    assert 8 <= np.count_nonzero(gaps > 1) <= 15


def test_without_errors_a_frame_comes_at_its_stamp_from_the_pose_of_the_step() -> None:
    tape = flown(Moving((0.3, 0.1)), CameraErrors(8), 1.0, "small")
    camera = SimulatedD435i(scene(), "small", "none")
    assert len(tape.frames) == 7
    for came_s, stamp_s, depth_mm, rgb in tape.frames:
        pose = np.eye(4)
        pose[:2, 3] = 0.3 * (stamp_s - START_S), 0.1 * (stamp_s - START_S)
        expected_mm, expected_rgb = camera.capture(pose, 0.0)
        assert came_s == stamp_s
        np.testing.assert_array_equal(depth_mm, expected_mm)
        np.testing.assert_array_equal(rgb, expected_rgb)


def test_one_seed_gives_one_stream() -> None:
    first, again, other = (flown(Moving((0.3, 0.1)), CameraErrors.drawn(seed), 2.0, "small") for seed in (4, 4, 5))
    for (_, a_s, a_mm, a_rgb), (_, b_s, b_mm, b_rgb) in zip(first.frames, again.frames, strict=True):
        assert a_s == b_s
        np.testing.assert_array_equal(a_mm, b_mm)
        np.testing.assert_array_equal(a_rgb, b_rgb)
    np.testing.assert_array_equal(np.array([s[2] for s in first.imu]), np.array([s[2] for s in again.imu]))
    assert (first.frames[1][2] != other.frames[1][2]).any()


def test_inertial_stamps_have_the_clock_offset_and_increase() -> None:
    errors = CameraErrors.drawn(2)
    stamps = np.array([stamp_s for stamp_s, _, _ in flown(Moving((0.0, 0.0)), errors, 1.0).imu])
    np.testing.assert_allclose(stamps - errors.imu.offset_s - START_S, np.arange(201) / 200.0, atol=1e-9)


def test_the_errors_are_written_beside_the_truth(tmp_path: Path) -> None:
    errors, nowhere = CameraErrors(2, mount=MountErrors((0.01, 0.0, 0.0))), cast(Any, None)
    camera = SimulatedD435i(scene(), "fast", errors=errors)
    world = OutsideWorld(cast(Any, Moving((0.0, 0.0))), camera, nowhere, nowhere, nowhere, START_S, 0.0, errors=errors)
    world.clearance = cast(Any, type("Clearance", (), {"batch": lambda _, positions: np.zeros(len(positions))})())
    world.truth_log.save(tmp_path / "truth.npz", world)
    assert CameraErrors.load(tmp_path / FILE_NAME) == errors
