"""Field of the surfaces: distances to planes by geometry, and where nothing is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from textured_room import CAMERA, LENS, frame_of

from uav_recon.localization.slam import tsdf_volume
from uav_recon.localization.slam.tsdf_volume import TRUNCATION_M, VOXEL_M, TsdfVolume, incidence, sample
from uav_recon.types.frames import Float32Array, FloatArray
from uav_recon.types.pose import Pose


def _plane_depth(normal: FloatArray, away_m: float) -> Float32Array:
    """Depth (H, W) of the plane normal . p = away_m in the camera's frame, NaN where it is not in front."""
    along = LENS.bearings() @ normal
    with np.errstate(divide="ignore"):
        depth = away_m / along
    return np.where((depth > 0.0) & (depth < 6.0), depth, np.nan).astype(np.float32)


def _read(volume: TsdfVolume, point_m: FloatArray) -> FloatArray | None:
    """Return distance and gradient and block (5,), None in unknown space."""
    out = np.full(5, np.nan)
    return out if sample(point_m, volume.index, volume.distance, volume.weight, out) else None


def _normal(tilt_rad: float, around_rad: float) -> FloatArray:
    """Direction (3,) from the camera to a plane: tilt against the optical axis."""
    across = math.sin(tilt_rad)
    return np.array([across * math.cos(around_rad), across * math.sin(around_rad), math.cos(tilt_rad)])


ANGLE = st.floats(-math.pi, math.pi)
PLACE = st.floats(-3.0, 3.0)


@settings(max_examples=25, deadline=None)
@given(
    tilt=st.floats(0.0, math.radians(70.0)),
    around=ANGLE,
    away=st.floats(1.0, 2.0),
    turn=st.tuples(ANGLE, st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)),
    place=st.tuples(PLACE, PLACE, PLACE),
    off=st.floats(-0.08, 0.12),
)
def test_a_plane_gives_the_distance_along_its_normal_at_any_angle(
    tilt: float,
    around: float,
    away: float,
    turn: tuple[float, float, float],
    place: tuple[float, float, float],
    off: float,
) -> None:
    volume, camera = TsdfVolume(), Pose.from_rotation_vector(np.array(turn), np.array(place))
    normal = _normal(tilt, around)
    volume.integrate(frame_of(0.0, _plane_depth(normal, away * math.cos(tilt))), camera, np.zeros(3))
    across = np.linalg.svd(normal[None])[2][1:]  # two directions in the plane
    spread = np.array([(i, j) for i in range(-4, 5) for j in range(-4, 5)]) * 0.03
    points = np.array([0.0, 0.0, away]) - off * normal + spread @ across
    found = [read for point in points if (read := _read(volume, camera.apply(point))) is not None]
    assert len(found) > 0.3 * len(points)  # at a grazing angle the corners of some blocks are not created
    half_pixel_m = 0.5 * 1.4 * away / LENS.fx * math.sin(tilt)  # a voxel reads its nearest pixel
    np.testing.assert_allclose([read[0] for read in found], off, atol=0.002 + half_pixel_m)
    mean = np.mean(found, axis=0)
    assert mean[0] == pytest.approx(off, abs=0.004)
    np.testing.assert_allclose(mean[1:4] / np.linalg.norm(mean[1:4]), -camera.rotation() @ normal, atol=0.04)
    assert np.linalg.norm(mean[1:4]) == pytest.approx(1.0, abs=0.03 + 0.12 * math.sin(tilt))


@pytest.mark.parametrize("tilt_deg", [0.0, 45.0, 80.0])
def test_incidence_is_the_cosine_over_the_ray(tilt_deg: float) -> None:
    """The distance to the plane per metre of depth is normal . bearing, for a unit normal."""
    normal = _normal(math.radians(tilt_deg), 0.4)
    depth = _plane_depth(normal, 1.2 * math.cos(math.radians(tilt_deg)))
    slope = incidence(depth, CAMERA)
    seen = slope > 0.0
    assert seen.mean() > 0.25
    np.testing.assert_allclose(slope[seen], (LENS.bearings() @ normal)[seen], atol=2e-3)


def test_nothing_is_known_where_nothing_was_seen() -> None:
    volume = TsdfVolume()
    assert _read(volume, np.zeros(3)) is None
    volume.integrate(frame_of(0.0, _plane_depth(_normal(0.0, 0.0), 2.0)), Pose.identity(), np.zeros(3))
    assert _read(volume, np.array([0.0, 0.0, 2.1])) is not None
    for nowhere in ([0.0, 0.0, 2.0 + TRUNCATION_M + 2 * VOXEL_M], [0.0, 0.0, -2.0], [5.0, 0.0, 2.0], [0.0, 0.0, 0.5]):
        assert _read(volume, np.array(nowhere)) is None, nowhere


def _step_depth() -> Float32Array:
    """A near wall in the left half of the image and a far one in the right half."""
    depth = np.full((LENS.height, LENS.width), 3.0, np.float32)
    depth[:, : LENS.width // 2] = 1.5
    return depth


def test_depth_without_returns_and_edges_write_no_nan_and_no_surface() -> None:
    depth, holes = _step_depth(), np.random.default_rng(0).random((LENS.height, LENS.width)) < 0.1
    depth[holes] = np.nan
    depth[5, 7], depth[50, 30], depth[60, 150] = 0.0, np.inf, -1.0
    volume = TsdfVolume()
    volume.integrate(frame_of(0.0, depth), Pose.identity(), np.zeros(3))
    assert np.isfinite(volume.distance).all()
    assert np.isfinite(volume.weight).all()
    assert (volume.weight > 0.0).any()
    slope = incidence(_step_depth(), CAMERA)
    assert not slope[:, LENS.width // 2 - 2 : LENS.width // 2 + 2].any(), "a plane through an edge"
    assert slope[LENS.height // 2, 20] > 0.0


def test_an_empty_image_creates_nothing() -> None:
    volume = TsdfVolume()
    volume.integrate(frame_of(0.0, np.full((LENS.height, LENS.width), np.nan, np.float32)), Pose.identity(), np.zeros(3))
    assert volume.count == 0


def test_more_blocks_than_the_first_pool_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = TsdfVolume()
    monkeypatch.setattr(tsdf_volume, "_FIRST_BLOCKS", 8)
    small = TsdfVolume()
    for yaw in (0.0, 1.5, 3.0):
        camera = Pose.from_rotation_vector(np.array([0.0, yaw, 0.0]), np.zeros(3))
        for volume in (whole, small):
            volume.integrate(frame_of(0.0, _plane_depth(_normal(0.5, 0.3), 2.0)), camera, np.zeros(3))
    assert small.count > 100
    assert small.count == whole.count
    assert len(np.unique(small.index)) == small.count + 1  # and none
    for point in (np.array([0.0, 0.0, 2.0 / math.cos(0.5)]), np.array([0.3, 0.2, 2.1])):
        a, b = _read(whole, point), _read(small, point)
        assert a is not None
        assert b is not None
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("corner", [[25.5, 0.0, 0.0], [-25.5, 0.0, 0.0], [0.0, 25.5, 0.0], [0.0, 0.0, 6.3], [0.0, 0.0, -6.3]])
def test_a_surface_outside_of_the_volume_is_left_out(corner: list[float]) -> None:
    volume, out = TsdfVolume(), np.full(5, np.nan)
    for turn in (
        [0.0, 0.0, 0.0],
        [0.0, math.pi / 2, 0.0],
        [0.0, -math.pi / 2, 0.0],
        [math.pi / 2, 0.0, 0.0],
        [math.pi, 0.0, 0.0],
    ):
        camera = Pose.from_rotation_vector(np.array(turn), np.array(corner))
        volume.integrate(frame_of(0.0, _plane_depth(_normal(0.0, 0.0), 2.0)), camera, np.zeros(3))
    assert np.isfinite(volume.distance).all()
    for away in (1.0, 1.05, 2.0, 100.0):
        point = np.array(corner) * away
        assert not sample(point, volume.index, volume.distance, volume.weight, out) or np.isfinite(out).all()
    assert _read(volume, np.array(corner) * 4.1) is None


def test_two_views_average() -> None:
    volume, normal = TsdfVolume(), _normal(0.0, 0.0)
    for away in (1.98, 2.02):
        volume.integrate(frame_of(0.0, _plane_depth(normal, away)), Pose.identity(), np.zeros(3))
    found = _read(volume, np.array([0.0, 0.0, 2.0]))
    assert found is not None
    assert found[0] == pytest.approx(0.0, abs=0.002)


def test_a_near_view_counts_more_than_a_far_one() -> None:
    volume = TsdfVolume()
    volume.integrate(frame_of(0.0, _plane_depth(_normal(0.0, 0.0), 1.0)), Pose.identity(), np.zeros(3))
    far = Pose(np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0]))
    volume.integrate(frame_of(0.0, _plane_depth(_normal(0.0, 0.0), 2.10)), far, np.zeros(3))  # 10 cm behind, at twice the range
    found = _read(volume, np.array([0.0, 0.0, 1.0]))
    assert found is not None
    assert found[0] == pytest.approx(0.1 * 1.0 / 2.1**2 / (1.0 + 1.0 / 2.1**2), abs=0.003)


def test_a_block_has_the_error_of_the_views_that_show_it() -> None:
    """Half of each voxel's weight is of the second view."""
    volume, image = TsdfVolume(), frame_of(0.0, _plane_depth(_normal(0.0, 0.0), 2.0))
    volume.integrate(image, Pose.identity(), np.full(3, 0.04**2))
    np.testing.assert_allclose(volume.variance[: volume.count], 0.04**2)
    volume.integrate(image, Pose.identity(), np.array([0.05**2, 0.04**2, 0.03**2]))
    seen = volume.variance[: volume.count]
    np.testing.assert_allclose(np.median(seen, axis=0), [(0.05**2 + 0.04**2) / 2, 0.04**2, (0.04**2 + 0.03**2) / 2])


def test_a_view_from_an_uncertain_place_changes_no_block_that_is_known_better() -> None:
    volume = TsdfVolume()
    volume.integrate(frame_of(0.0, _plane_depth(_normal(0.0, 0.0), 2.0)), Pose.identity(), np.full(3, 0.02**2))
    before = volume.distance[: volume.count].copy()
    volume.integrate(frame_of(0.0, _plane_depth(_normal(0.0, 0.0), 2.05)), Pose.identity(), np.full(3, 0.15**2))
    np.testing.assert_array_equal(volume.distance[: len(before)], before)
    volume.integrate(frame_of(0.0, _plane_depth(_normal(0.0, 0.0), 2.05)), Pose.identity(), np.full(3, 0.03**2))
    assert np.abs(volume.distance[: len(before)] - before).max() > 0.01
