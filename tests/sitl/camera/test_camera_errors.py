"""Errors of the simulated camera: their bounds, and each of them measured in rendered images."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from sitl.camera import camera_errors as drawn
from sitl.camera.camera_error_scale import DEFAULT, WORDS, scale_of
from sitl.camera.camera_errors import CameraErrors, MountErrors, OpticsErrors, TimingErrors, ToneErrors
from sitl.camera.d435i import COLOUR_SPEC, DEPTH_SPEC, SimulatedD435i, stream_header
from sitl.camera.frame_exposure import FrameExposure, MountPose
from sitl.geometry.transform import world_from_body
from sitl.scene.builtin_room import built_in_room
from sitl.scene.rasterizer import Renderer

F64 = NDArray[np.float64]
HALF_M = 1.5
BODY_FROM_RDF = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
SEEDS = range(200)


def quads(*faces: tuple[Any, tuple[int, int, int]]) -> Renderer:
    """Return a scene of quadrilaterals, each with its corners (4, 3) and its colour."""
    vertices = np.concatenate([np.asarray(corners, np.float32) for corners, _ in faces])
    order = np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * n for n in range(len(faces))]).astype(np.int32)
    return Renderer(vertices, order, np.repeat(np.array([rgb for _, rgb in faces], np.uint8), 4, axis=0))


def upright(x: float, y: tuple[float, float], z: tuple[float, float]) -> list[list[float]]:
    return [[x, y[0], z[0]], [x, y[1], z[0]], [x, y[1], z[1]], [x, y[0], z[1]]]


def cube() -> Renderer:
    """Return the inside of a cube around the origin."""
    corners = HALF_M * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return quads(*((corners[list(side)], (90, 90, 90)) for side in sides))


def nominal(pitch_down_rad: float) -> F64:
    """Return the nominal pose (4, 4) of the depth imager in the body, by another way than the simulator's."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec((0.0, pitch_down_rad, 0.0)).as_matrix() @ BODY_FROM_RDF
    pose[:3, 3] = (0.10, 0.0, 0.0)
    return pose


def measured_mount(errors: CameraErrors, pitch_down_rad: float) -> F64:
    """Return rotation vector and translation of the true imager in the nominal one, by fitting depth to a cube's walls."""
    body = world_from_body((0.2, -0.1, 0.1), math.pi / 4)
    depth_mm, _ = SimulatedD435i(cube(), "d435i", "none", errors=errors).capture(body, pitch_down_rad)
    v, u = (index[::7] for index in np.nonzero(depth_mm))
    z = depth_mm[v, u] * 1e-3
    points = np.stack([(u - DEPTH_SPEC.cx) / DEPTH_SPEC.fx * z, (v - DEPTH_SPEC.cy) / DEPTH_SPEC.fy * z, z], axis=1)
    start = body @ nominal(pitch_down_rad)

    def off_the_walls(guess: F64) -> F64:
        inner = Rotation.from_rotvec(guess[:3]).apply(points) + guess[3:]
        world = inner @ start[:3, :3].T + start[:3, 3]
        return np.asarray(np.abs(world).max(axis=1) - HALF_M)

    return np.asarray(least_squares(off_the_walls, np.zeros(6), loss="soft_l1", f_scale=1e-3).x)


# -- the numbers -------------------------------------------------------------------------------------------------------


def values(name: str, *group: str) -> F64:
    """Return one number of every seed's errors, (S,) or (S, 3)."""
    return np.array([getattr(getattr(CameraErrors.drawn(seed, gimbal=True), group[0]), name) for seed in SEEDS])


@pytest.mark.parametrize(
    ("group", "name", "low", "high"),
    [
        ("mount", "rotation_rad", -math.radians(1.0), math.radians(1.0)),
        ("mount", "translation_m", -0.010, 0.010),
        ("mount", "gimbal_rad", -math.radians(1.0), math.radians(1.0)),
        ("optics", "depth_focal", -0.01, 0.01),
        ("optics", "colour_focal", -0.01, 0.01),
        ("optics", "depth_scale", -0.015, 0.015),
        ("optics", "colour_rotation_rad", -math.radians(0.3), math.radians(0.3)),
        ("optics", "colour_translation_m", -0.005, 0.005),
        ("timing", "age_s", 0.0, 0.040),
        ("timing", "colour_delay_s", 0.0, 0.020),
        ("timing", "readout_s", 0.015, 0.030),
        ("imu", "accel_density_flight", 0.049, 0.091),
        ("imu", "gyro_density_flight", 0.0007, 0.0013),
        ("imu", "offset_s", -0.005, 0.005),
    ],
)
def test_two_hundred_seeds_fill_the_interval_and_do_not_leave_it(group: str, name: str, low: float, high: float) -> None:
    found = values(name, group).reshape(len(SEEDS), -1)
    assert (found >= low).all()
    assert (found <= high).all()
    assert (found.min(axis=0) < low + 0.05 * (high - low)).all()
    assert (found.max(axis=0) > high - 0.05 * (high - low)).all()
    assert np.abs(found.mean(axis=0) - 0.5 * (low + high)).max() < 0.08 * (high - low)


def test_the_numbers_of_a_seed_are_independent_of_each_other() -> None:
    table = []
    for seed in SEEDS:
        errors, row = CameraErrors.drawn(seed, gimbal=True), list[float]()
        for group in (errors.mount, errors.optics, errors.timing):
            for value in dataclasses.astuple(group):
                row += value if isinstance(value, tuple) else [value]
        table.append(row)
    varying = np.array(table)[:, np.ptp(np.array(table), axis=0) > 0]
    assert varying.shape[1] == 19
    assert np.abs(np.corrcoef(varying.T) - np.eye(19)).max() < 0.28


def test_scale_zero_is_the_exact_camera_and_a_half_halves_everything() -> None:
    assert CameraErrors.drawn(3, 0.0) == CameraErrors(3)
    whole, half = CameraErrors.drawn(3, gimbal=True), CameraErrors.drawn(3, 0.5, gimbal=True)
    for group in ("mount", "optics", "timing", "tone", "imu"):
        a, b = (np.hstack(dataclasses.astuple(getattr(errors, group))) for errors in (whole, half))
        np.testing.assert_allclose(b, 0.5 * a, rtol=1e-12)
    assert (half.loss.min_gap_s, half.loss.max_frames) == (2.0 * whole.loss.min_gap_s, whole.loss.max_frames)


def test_only_a_gimbal_has_an_angle_error_and_it_changes_nothing_else() -> None:
    fixed, gimbal = CameraErrors.drawn(4), CameraErrors.drawn(4, gimbal=True)
    assert fixed.mount.gimbal_rad == 0.0
    assert replace(gimbal, mount=replace(gimbal.mount, gimbal_rad=0.0)) == fixed


def test_the_errors_are_read_back_from_their_file(tmp_path: Path) -> None:
    errors = CameraErrors.drawn(11, gimbal=True)
    errors.save(tmp_path / drawn.FILE_NAME)
    assert CameraErrors.load(tmp_path / drawn.FILE_NAME) == errors
    assert [file.name for file in tmp_path.iterdir()] == [drawn.FILE_NAME]


def test_the_option_is_a_word_or_a_factor() -> None:
    assert [scale_of(text) for text in ("none", "default", "0.5", "2", "0")] == [0.0, 1.0, 0.5, 2.0, 0.0]
    assert scale_of(None) == WORDS[DEFAULT]
    for text in ("some", "-0.1", "2.1", "nan", "inf", ""):
        with pytest.raises(ValueError, match="a factor of 0 to 2"):
            scale_of(text)


# -- mount and lenses --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1])
def test_the_depth_imager_is_off_by_the_errors_of_the_mount(seed: int) -> None:
    mount = CameraErrors.drawn(seed).mount
    found = measured_mount(CameraErrors(mount=mount), 0.35)
    np.testing.assert_allclose(found[:3], mount.rotation_rad, atol=math.radians(0.01))
    np.testing.assert_allclose(found[3:], mount.translation_m, atol=2e-4)


def test_a_gimbal_looks_further_down_than_it_reports() -> None:
    """A tilt about the lateral axis is a negative rotation about the camera's right; the imager stays where it is."""
    found = measured_mount(CameraErrors(mount=MountErrors(gimbal_rad=0.015)), 0.35)
    np.testing.assert_allclose(found, (-0.015, 0.0, 0.0, 0.0, 0.0, 0.0), atol=2e-4)


@pytest.mark.parametrize("share", [-0.015, 0.01])
def test_depth_is_scaled(share: float) -> None:
    wall = quads((upright(2.1, (-9, 9), (-9, 9)), (9, 9, 9)))
    camera = SimulatedD435i(wall, "d435i", "none", errors=CameraErrors(optics=OpticsErrors(depth_scale=share)))
    assert camera.capture(np.eye(4), 0.0)[0] == pytest.approx(2000.0 * (1.0 + share), abs=0.6)


def test_the_depth_lens_is_longer_than_the_header_says() -> None:
    """On a wall that is turned by 40 degrees 1/z is linear in the column: slope over intercept is tan(40 deg) / f."""
    slope, away = math.tan(math.radians(40.0)), 2.0
    y = np.array([-2.0, 2.0])
    x = 0.1 + away + y * slope
    wall = quads(([[x[0], y[0], -5], [x[1], y[1], -5], [x[1], y[1], 5], [x[0], y[0], 5]], (9, 9, 9)))
    camera = SimulatedD435i(wall, "d435i", "none", errors=CameraErrors(optics=OpticsErrors(depth_focal=0.01)))
    depth = camera.capture(np.eye(4), 0.0)[0][120].astype(np.float64) * 1e-3
    u = np.flatnonzero(depth > 0)
    rise, level = np.polyfit(u - DEPTH_SPEC.cx, 1.0 / depth[u], 1)
    assert abs(slope / (rise / level)) / camera.header.depth.fx == pytest.approx(1.01, abs=5e-4)
    assert camera.header == stream_header("d435i")


def marks() -> tuple[F64, Renderer]:
    """Return the centres (N, 3) of white squares at different distances before a black wall, and their scene."""
    centres, faces = [], [(upright(4.0, (-9, 9), (-9, 9)), (0, 0, 0))]
    for n in range(35):
        x = (0.8, 1.3, 2.1, 3.3)[n * 7 % 4]
        y, z, half = 0.18 * (n % 7 - 3) * (x - 0.1), 0.14 * (n // 7 - 2) * (x - 0.1), 0.035 * (x - 0.1)
        faces.append((upright(x, (y - half, y + half), (z - half, z + half)), (255, 255, 255)))
        centres.append((x, y, z))
    return np.array(centres), quads(*faces)


def seen_marks(rgb: NDArray[np.uint8]) -> F64:
    """Return the centroids (N, 2) of the white spots, by column and row."""
    from scipy import ndimage

    white = rgb[..., 1].astype(np.float64)
    labels, count = ndimage.label(white > 20)
    centres = np.array(ndimage.center_of_mass(white, labels, range(1, count + 1)))
    return np.asarray(centres[:, ::-1])


def test_the_colour_imager_is_off_by_its_errors_against_the_header() -> None:
    optics = replace(CameraErrors.drawn(2).optics, depth_focal=0.0, depth_scale=0.0)
    centres, scene = marks()
    pixels = seen_marks(SimulatedD435i(scene, errors=CameraErrors(optics=optics)).capture(np.eye(4), 0.0)[1])
    assert len(pixels) == len(centres)

    def predicted(guess: F64) -> F64:
        depth = (centres - np.array([0.10, 0.0, 0.0])) @ BODY_FROM_RDF
        inner = Rotation.from_rotvec(guess[:3]).inv().apply(depth + np.array([0.015, 0.0, 0.0]) - guess[3:6])
        f = np.array([COLOUR_SPEC.fx, COLOUR_SPEC.fy]) * (1.0 + guess[6])
        return np.asarray(inner[:, :2] / inner[:, 2:] * f + (COLOUR_SPEC.cx, COLOUR_SPEC.cy))

    def errors_px(guess: F64) -> F64:
        gaps = np.linalg.norm(predicted(guess)[:, None] - pixels[None], axis=2)
        return np.asarray((predicted(guess) - pixels[gaps.argmin(axis=1)]).ravel())

    found = least_squares(errors_px, np.zeros(7), x_scale=[1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3]).x
    np.testing.assert_allclose(found[:3], optics.colour_rotation_rad, atol=math.radians(0.02))
    np.testing.assert_allclose(found[3:6], optics.colour_translation_m, atol=1e-3)
    assert found[6] == pytest.approx(optics.colour_focal, abs=5e-4)


# -- rolling shutter ---------------------------------------------------------------------------------------------------


def moving(first: F64, last: F64, share: float) -> F64:
    """Return the pose (4, 4) at a share of the motion between two poses."""
    pose, turn = np.eye(4), Rotation.from_matrix(first[:3, :3].T @ last[:3, :3]).as_rotvec()
    pose[:3, :3] = first[:3, :3] @ Rotation.from_rotvec(share * turn).as_matrix()
    pose[:3, 3] = (1.0 - share) * first[:3, 3] + share * last[:3, 3]
    return pose


def test_each_row_shows_what_the_camera_sees_when_it_is_read() -> None:
    """The motion is that of 30 ms at 0.8 m/s, 60 deg/s of yaw and 20 deg/s of roll and pitch, in the furnished room."""
    room = built_in_room(True)
    scene = Renderer((room.vertices - np.array([1.5, 1.5, 1.0])).astype(np.float32), room.faces, room.rgb)
    first, last = world_from_body((0.5, 0.3, 0.2), 0.7), world_from_body((0.518, 0.314, 0.206), 0.7)
    last[:3, :3] = last[:3, :3] @ Rotation.from_rotvec(np.radians([0.6, 0.6, 1.8])).as_matrix()
    poses = [MountPose(moving(first, last, share), 0.1) for share in (0.5, 0.0, 0.5, 1.0)]
    errors = CameraErrors(timing=TimingErrors(readout_s=0.030))
    rolled = SimulatedD435i(scene, errors=errors).expose(FrameExposure(0.0, *poses))[1].astype(np.float64)
    exact, still = SimulatedD435i(scene), SimulatedD435i(scene).capture(poses[0].world_from_body, 0.1)[1]
    wrong, unmoved = [], []
    for v in range(0, 240, 13):
        true = exact.capture(moving(first, last, v / 239.0), 0.1)[1][v].astype(np.float64)
        wrong.append(np.abs(rolled[v] - true).max(axis=1))
        unmoved.append(np.abs(still[v] - true).max(axis=1))
    assert np.mean(np.array(unmoved) > 20) > 0.10  # the motion changes the image
    assert np.mean(np.array(wrong) > 20) < 0.25 * np.mean(np.array(unmoved) > 20)
    assert np.median(wrong) <= 2.0


def test_a_camera_at_rest_reads_the_image_of_a_global_shutter() -> None:
    scene = marks()[1]
    plain = SimulatedD435i(scene).capture(np.eye(4), 0.0)[1]
    rolled = SimulatedD435i(scene, errors=CameraErrors(timing=TimingErrors(readout_s=0.02))).capture(np.eye(4), 0.0)[1]
    np.testing.assert_array_equal(plain, rolled)


# -- exposure and white balance ----------------------------------------------------------------------------------------


def light(value: F64) -> F64:
    """Return the linear light of sRGB values."""
    return np.asarray(np.where(value <= 10, value / 255 / 12.92, ((value / 255 + 0.055) / 1.055) ** 2.4))


def test_exposure_and_white_balance_wander_slowly_within_their_bounds() -> None:
    wall = quads((upright(2.1, (-9, 9), (-9, 9)), (120, 120, 120)))
    errors = CameraErrors(5, tone=CameraErrors.drawn(5).tone)
    camera = SimulatedD435i(wall, "small", "none", errors=errors)
    stamps = np.arange(0.0, 300.0, 0.5)
    shown = np.array([camera.capture(np.eye(4), 0.0, stamp_s)[1][60, 100] for stamp_s in stamps], np.float64)
    gains = np.log(light(shown) / light(np.full(3, 120.0)))
    stops = gains[:, 1] / math.log(2.0)
    assert np.abs(stops).max() < drawn.EXPOSURE_EV + 0.02
    assert np.ptp(stops) > 0.3
    assert np.std(np.diff(stops)) == pytest.approx(errors.tone.exposure_rate_ev * math.sqrt(0.5), rel=0.25)
    for channel in (0, 2):
        balance = gains[:, channel] - gains[:, 1]
        assert np.abs(balance).max() < drawn.BALANCE + 0.03
        assert np.ptp(balance) > 0.03


# -- the exact camera --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["d435i", "wide", "fast", "small"])
def test_an_exact_camera_is_the_default_one(model: Any) -> None:
    scene = marks()[1]
    plain = SimulatedD435i(scene, model, seed=9)
    none = SimulatedD435i(scene, model, seed=9, errors=CameraErrors.drawn(9, 0.0))
    for _ in range(2):
        for a, b in zip(plain.capture(np.eye(4), 0.2), none.capture(np.eye(4), 0.2), strict=True):
            np.testing.assert_array_equal(a, b)


def test_an_exact_colour_camera_is_one_rendering_at_the_middle_of_the_exposure() -> None:
    scene, poses = marks()[1], [MountPose(world_from_body((0.0, 0.0, 0.0), 0.02 * k), 0.0) for k in (0, -1, 0, 1)]
    world_from_rgb = nominal(0.0)
    world_from_rgb[:3, 3] += (0.0, 0.015, 0.0)
    expected = scene.render(world_from_rgb, COLOUR_SPEC).rgb
    found = SimulatedD435i(scene).expose(FrameExposure(0.0, *poses))[1]
    assert (found != expected).mean() < 1e-3  # the poses agree to rounding


@pytest.mark.parametrize("model", ["d435i", "wide", "small"])
def test_equal_seeds_give_equal_images(model: Any) -> None:
    scene = marks()[1]
    first, again, other = (SimulatedD435i(scene, model, seed=3, errors=CameraErrors.drawn(seed)) for seed in (3, 3, 4))
    a, b, c = (camera.capture(np.eye(4), 0.2, 1.0) for camera in (first, again, other))
    for k in (0, 1):
        np.testing.assert_array_equal(a[k], b[k])
        assert (a[k] != c[k]).any()


def test_a_registered_camera_has_the_errors_of_its_colour_too() -> None:
    errors = CameraErrors(optics=OpticsErrors(colour_translation_m=(0.005, 0.0, 0.0)), tone=ToneErrors())
    scene = marks()[1]
    exact, off = (
        seen_marks(SimulatedD435i(scene, "wide", errors=e).capture(np.eye(4), 0.0)[1]) for e in (CameraErrors(), errors)
    )
    assert len(exact) == len(off)
    assert np.median(exact[:, 0] - off[:, 0]) == pytest.approx(0.005 * DEPTH_SPEC.fx / 2.2, abs=0.25)
