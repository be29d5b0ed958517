from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sitl.camera.d435i import BASELINE_M, COLOUR_SPEC, DEPTH_SPEC, Noise, SimulatedD435i, pinhole, stream_header
from sitl.geometry.transform import world_from_body
from sitl.scene.rasterizer import Renderer

F64 = NDArray[np.float64]


def quad(x: float, y: tuple[float, float], z: tuple[float, float], colour: tuple[int, int, int]) -> list[object]:
    corners = [[x, y[0], z[0]], [x, y[1], z[0]], [x, y[1], z[1]], [x, y[0], z[1]]]
    return [
        np.array(corners, np.float32),
        np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        np.tile(np.array(colour, np.uint8), (4, 1)),
    ]


def renderer(*quads: list[object]) -> Renderer:
    vertices = np.concatenate([np.asarray(q[0], np.float32) for q in quads])
    faces = np.concatenate([np.asarray(q[1], np.int32) + 4 * i for i, q in enumerate(quads)])
    return Renderer(vertices, faces, np.concatenate([np.asarray(q[2], np.uint8) for q in quads]))


def wall(distance_m: float) -> Renderer:
    """Return a wall across the whole image, in front of the depth imager.

    The body is at the origin, and the wall is distance_m from the imager.
    """
    return renderer(quad(0.10 + distance_m, (-30, 30), (-30, 30), (50, 60, 70)))


def errors_m(noise: Noise, distance_m: float, frames: int = 6) -> F64:
    camera = SimulatedD435i(wall(distance_m), "d435i", noise, seed=4)
    depth = np.array([camera.capture(np.eye(4), 0.0)[0] for _ in range(frames)]).astype(np.float64) * 1e-3
    return np.where(depth > 0, depth - distance_m, np.nan)


def test_fields_of_view() -> None:
    for spec, angles in ((DEPTH_SPEC, (87.0, 58.0)), (COLOUR_SPEC, (69.0, 42.0))):
        assert (spec.width, spec.height) == (424, 240)
        assert math.degrees(2 * math.atan(0.5 * 424 / spec.fx)) == pytest.approx(angles[0])
        assert math.degrees(2 * math.atan(0.5 * 240 / spec.fy)) == pytest.approx(angles[1])
    assert stream_header("wide").depth == stream_header("wide").rgb
    assert stream_header("d435i").rgb_from_depth == (1.0, 0.0, 0.0, 0.0, 0.015, 0.0, 0.0)


@pytest.mark.parametrize("distance_m", [1.0, 2.0, 4.0])
def test_stereo_error_grows_with_the_square_of_the_distance(distance_m: float) -> None:
    """14 mm at 2 m: z² · 0.08 px / (f · 5 cm), with f of the matched 848 pixel wide image."""
    focal_px = pinhole(848, 480, 87.0, 58.0).fx
    expected = distance_m**2 * 0.08 / (focal_px * BASELINE_M)
    error = errors_m("d435i", distance_m)
    assert np.nanstd(error) == pytest.approx(expected, rel=0.06)
    assert abs(np.nanmean(error)) < 0.05 * expected + 0.02 * distance_m * expected


def test_stereo_error_is_smooth_in_the_image_and_independent_between_frames() -> None:
    error = errors_m("d435i", 2.0)[:, :, 30:]
    error = np.nan_to_num(error / np.nanstd(error))
    beside = (error[:, :, 1:] * error[:, :, :-1]).mean()
    near = (error[:, :, 3:] * error[:, :, :-3]).mean()
    far = (error[:, :, 12:] * error[:, :, :-12]).mean()
    assert beside > 0.8
    assert 0.2 < near < 0.7
    assert abs(far) < 0.05
    assert abs((error[1:] * error[:-1]).mean()) < 0.05


@pytest.mark.parametrize(("noise", "expected"), [("paper", 0.003), ("kinect", 0.001 + 0.0019 * 2.6**2), ("none", 0.0)])
def test_other_noises_at_three_metres(noise: Noise, expected: float) -> None:
    error = errors_m(noise, 3.0, frames=2)
    assert np.nanstd(error) == pytest.approx(expected, rel=0.03, abs=1e-4)
    assert not np.isnan(error).any()


@pytest.mark.parametrize(("distance_m", "seen"), [(0.25, False), (0.35, True), (5.0, True), (6.3, False)])
def test_nothing_returns_outside_the_range(distance_m: float, seen: bool) -> None:
    for noise in ("none", "paper", "kinect"):
        depth, _ = SimulatedD435i(wall(distance_m), "d435i", noise).capture(np.eye(4), 0.0)
        assert (depth > 0).all() if seen else (depth == 0).all()


def test_same_seed_and_frame_number_give_the_same_noise() -> None:
    first, again, other = (SimulatedD435i(wall(2.0), "d435i", "d435i", seed) for seed in (1, 1, 2))
    a, b, c = ([camera.capture(np.eye(4), 0.1)[0] for _ in range(2)] for camera in (first, again, other))
    np.testing.assert_array_equal(a, b)
    assert (a[0] != a[1]).mean() > 0.5
    assert (a[0] != c[0]).mean() > 0.5


def test_surface_seen_by_one_imager_only_is_a_hole_beside_the_near_object() -> None:
    """A post at 1 m before a wall at 3 m hides f·b·(1/1 - 1/3) = 7.4 px of the wall.

    They are on its left; none are hidden on its right.
    """
    view = renderer(quad(1.1, (-0.2, 0.2), (-3, 3), (9, 9, 9)), quad(3.1, (-9, 9), (-9, 9), (9, 9, 9)))
    depth, _ = SimulatedD435i(view, "d435i", "d435i").capture(np.eye(4), 0.0)
    row = depth[120]
    left, right = DEPTH_SPEC.cx - 0.2 * DEPTH_SPEC.fx, DEPTH_SPEC.cx + 0.2 * DEPTH_SPEC.fx
    holes = np.flatnonzero(row == 0)
    beside = holes[holes > 20]
    assert len(beside) == pytest.approx(7.4, abs=1.0)
    assert beside.max() == pytest.approx(left - 0.5, abs=1.0)
    assert (row[math.ceil(right) : math.ceil(right) + 20] > 2500).all()
    assert np.abs(holes[holes <= 20]).max() == pytest.approx(DEPTH_SPEC.fx * 0.05 / 3 - 1, abs=1.0)  # outside imager 2


def test_grazing_surfaces_give_no_depth() -> None:
    """At an incidence cosine of 0.1 a floor has no depth, at 0.3 it has."""
    floor = [np.array([[0, -9, -0.5], [9, -9, -0.5], [9, 9, -0.5], [0, 9, -0.5]], np.float32),
             np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.zeros((4, 3), np.uint8)]  # fmt: skip
    depth, _ = SimulatedD435i(renderer(floor), "d435i", "d435i").capture(np.eye(4), 0.0)
    v = np.arange(240)
    slope = (v - DEPTH_SPEC.cy) / DEPTH_SPEC.fy
    cosine = slope / np.hypot(1, slope)
    column = depth[:, 212]
    assert (column[(cosine > 0.02) & (cosine < 0.11)] == 0).all()
    assert (column[cosine > 0.25] > 0).all()
    edge = depth[:, 150:270][(cosine > 0.165) & (cosine < 0.185)]
    assert 0.2 < (edge > 0).mean() < 0.8


def test_the_colour_camera_is_left_of_the_depth_camera_and_narrower() -> None:
    """A mark straight before the colour imager is at the centre of the colour image.

    In the depth image it is left of the centre.
    """
    mark = renderer(quad(1.1, (-6e-3 + 0.015, 6e-3 + 0.015), (-3, 3), (255, 0, 0)), quad(3, (-9, 9), (-9, 9), (0, 0, 9)))
    depth_view = SimulatedD435i(mark, "wide", "none").capture(np.eye(4), 0.0)[1]
    colour_view = SimulatedD435i(mark, "d435i", "none").capture(np.eye(4), 0.0)[1]
    wide_u = np.flatnonzero(depth_view[100, :, 0] > 100)
    colour_u = np.flatnonzero(colour_view[100, :, 0] > 100)
    assert np.mean(colour_u) == pytest.approx(COLOUR_SPEC.cx, abs=0.6)
    assert np.mean(wide_u) == pytest.approx(DEPTH_SPEC.cx - 0.015 * DEPTH_SPEC.fx, abs=1.0)


def test_the_camera_is_mounted_ten_centimetres_ahead_of_the_body() -> None:
    """The body is 1 m above a floor, and the camera is pitched straight down.

    The image centre is then 1 m away and 0.1 m ahead.
    """
    floor = [np.array([[-9, -9, -1], [9, -9, -1], [9, 9, -1], [-9, 9, -1]], np.float32),
             np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.zeros((4, 3), np.uint8)]  # fmt: skip
    spot = quad(0.0, (-0.02, 0.02), (-0.02, 0.02), (255, 255, 255))
    ahead = np.asarray(spot[0], np.float32)[:, [2, 1, 0]] + np.array([0.1, 0, -0.999], np.float32)
    view = renderer(floor, [ahead, spot[1], spot[2]])
    depth, rgb = SimulatedD435i(view, "wide", "none").capture(np.eye(4), math.pi / 2)
    assert (np.abs(depth.astype(int) - 1000) <= 2).all()
    v, u = np.nonzero(rgb[..., 0] > 200)
    assert (u.mean(), v.mean()) == (pytest.approx(211.5, abs=0.6), pytest.approx(119.5, abs=0.6))
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_rotvec((0, 0, 1.0)).as_matrix()
    np.testing.assert_array_equal(world_from_body((0, 0, 0), 1.0).round(12), turned.round(12))
