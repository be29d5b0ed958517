import json
import time
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from uav_recon.mapping.occupancy.occupancy_map import DepthSensor, OccupancyMap
from uav_recon.types.camera import BODY_FROM_OPTICAL, Frame, Intrinsics, PosedFrame
from uav_recon.types.frames import ByteArray, Float32Array, FloatArray
from uav_recon.types.maps import FREE, OCCUPIED, TILE, UNKNOWN, GridSpec
from uav_recon.types.pose import Pose

STREAM = Path(__file__).parents[4] / "shared" / "streams" / "two_room"
LENS = Intrinsics.from_fov(212, 120, np.radians(87), np.radians(58))
GRID = GridSpec(np.array([-2.0, -3.0, 0.0]), 0.1, (80, 60, 30))
D435I = DepthSensor(0.3, 0.04, 0.05)
NO_COLOUR = np.zeros((1, 1, 3), dtype=np.uint8)
ONE_VOXEL = np.ones((3, 3, 3), dtype=bool)


def voxels(
    fence_min: tuple[float, float, float] = (-2, -3, 0), fence_max: tuple[float, float, float] = (6, 3, 3)
) -> OccupancyMap:
    return OccupancyMap(GRID, D435I, 5.0, fence_min, fence_max, 1.1)


def posed(depth_m: Float32Array, world_from_depth: Pose, lens: Intrinsics = LENS, epoch: int = 0) -> PosedFrame:
    return PosedFrame(Frame(0.0, 0, depth_m, lens, NO_COLOUR, lens, Pose.identity()), world_from_depth, epoch)


def looking(x: float, y: float, z: float, yaw_rad: float = 0.0) -> Pose:
    return Pose.from_yaw(yaw_rad, np.array([x, y, z])) @ Pose.from_matrix(BODY_FROM_OPTICAL)


def depth_of_box(pose: Pose, low: FloatArray, high: FloatArray) -> Float32Array:
    """Return the depth image of a box room from inside.

    It is the exit of each ray, by the slab method.
    """
    rays = LENS.bearings() @ pose.rotation().T
    with np.errstate(divide="ignore", invalid="ignore"):
        walls = np.stack([(low - pose.translation_m) / rays, (high - pose.translation_m) / rays])
    return np.asarray(np.nanmin(np.nanmax(walls, axis=0), axis=-1), dtype=np.float32)


ROOM = (np.array([-1.52, -1.52, 0.02]), np.array([3.02, 1.52, 2.52]))


def by_scipy(state: ByteArray, reach: int) -> FloatArray:
    distance: FloatArray = ndimage.distance_transform_edt(np.pad(state == FREE, 1))[1:-1, 1:-1, 1:-1]
    return np.round(np.minimum(distance, reach) ** 2)


def noisy(depth_m: Float32Array, rng: np.random.Generator) -> Float32Array:
    """Add a correlated disparity error of 15 mm at 2 m."""
    error = ndimage.gaussian_filter(rng.normal(size=depth_m.shape), 2.0)
    return np.asarray(depth_m + error / error.std() * 0.00375 * depth_m**2, dtype=np.float32)


def shaken(pose: Pose, rng: np.random.Generator) -> Pose:
    return pose @ Pose.from_rotation_vector(rng.normal(0, np.radians(0.3), 3), rng.normal(0, 0.01, 3))


def test_frees_in_front_marks_the_end_and_leaves_the_rest_unknown() -> None:
    room = voxels()
    wall = posed(np.full((120, 212), 2.0, dtype=np.float32), looking(0.05, 0.05, 1.45))
    room.integrate(wall)
    once = room.snapshot().state
    assert not (once == FREE).any()  # one frame does not free a voxel
    assert once[40, 30, 14] == OCCUPIED  # one close return marks a voxel occupied
    room.integrate(wall)
    state = room.snapshot().state
    assert (state[24:39, 30, 14] == FREE).all()
    assert (state[40, 22:39, 10:19] == OCCUPIED).all()
    assert (state[42:] == UNKNOWN).all() and (state[:20] == UNKNOWN).all()


def test_pixels_without_a_return_change_nothing() -> None:
    room = voxels()
    for nothing in (np.nan, np.inf, 0.0, 0.1):
        assert room.integrate(posed(np.full((120, 212), nothing, dtype=np.float32), looking(0, 0, 1.5))) == 0
    assert (room.snapshot().state == UNKNOWN).all() and room.explored_m3() == 0.0


@pytest.mark.parametrize("nothing", [np.nan, np.inf, 0.0])
def test_a_hole_frees_nothing_behind_it(nothing: float) -> None:
    depth_m = np.full((120, 212), 3.0, dtype=np.float32)
    depth_m[50:70, 96:116] = nothing
    room = voxels()
    for _ in range(5):
        room.integrate(posed(depth_m, looking(0.05, 0.05, 1.45)))
    state = room.snapshot().state
    assert (state[25:50, 30, 14] != FREE).all() and (state[45, 37:42, 14] == FREE).all()


def test_a_return_beyond_the_range_frees_space_up_to_it_and_marks_nothing() -> None:
    room = voxels()
    for _ in range(4):
        room.integrate(posed(np.full((120, 212), 9.0, dtype=np.float32), looking(0.05, 0.05, 1.45)))
    state = room.snapshot().state
    assert (state[25:68, 30, 14] == FREE).all() and (state[71:, 30, 14] == UNKNOWN).all()
    assert not (state == OCCUPIED).any()


def test_space_within_the_depth_noise_of_a_far_wall_stays_unknown() -> None:
    room, sharp = voxels(), OccupancyMap(GRID, DepthSensor(0.3, 0.001, 0.05), 5.0, (-2, -3, 0), (6, 3, 3), 1.1)
    for _ in range(8):
        for one in (room, sharp):
            one.integrate(posed(np.full((120, 212), 4.02, dtype=np.float32), looking(0.0, 0.05, 1.45)))
    assert sharp.snapshot().state[58, 30, 14] == FREE  # 0.17 m in front of the wall, noise of 2 mm ...
    assert room.snapshot().state[58, 30, 14] == UNKNOWN  # ... and of 116 mm
    assert room.snapshot().state[55, 30, 14] == FREE


def test_outside_the_fence_nothing_is_free_but_may_be_occupied() -> None:
    room = voxels(fence_max=(1.5, 3, 3))
    for _ in range(4):
        room.integrate(posed(np.full((120, 212), 2.0, dtype=np.float32), looking(0.05, 0.05, 1.45)))
    picture = room.snapshot()
    assert not (picture.state[35:] == FREE).any() and (picture.state[34, 30, 14]) == FREE
    assert picture.state[40, 30, 14] == OCCUPIED
    assert picture.distance2[34, 30, 14] == 1


def test_grazing_rays_and_noise_do_not_carve_the_walls() -> None:
    rng = np.random.default_rng(3)
    room = voxels()
    for step in range(120):  # along the wall y = -1.52, 0.4 m from it, looking along it and at it in turn
        true = looking(-1.0 + step * 0.02, -1.1, 1.2, float(rng.uniform(-1.2, 0.6)))
        room.integrate(posed(noisy(depth_of_box(true, *ROOM), rng), shaken(true, rng)))
    state = room.snapshot().state
    i, j, k = np.indices(state.shape)
    centre = GRID.centre(np.stack([i, j, k], axis=-1))
    behind_m = np.max(np.maximum(ROOM[0] - centre, centre - ROOM[1]), axis=-1)
    assert not (state[behind_m > 0.05] == FREE).any()  # no voxel is free whose centre is half a voxel or more behind a wall
    well_inside = (behind_m < -0.2) & (centre[..., 0] > -0.2) & (centre[..., 0] < 2.5) & (np.abs(centre[..., 2] - 1.2) < 0.4)
    well_inside &= centre[..., 1] < -0.3
    assert (state[well_inside] == FREE).mean() > 0.99
    assert not (state[behind_m < -0.3] == OCCUPIED).any()


def test_a_false_obstacle_is_cleared_by_later_frames_and_a_speckle_does_not_stay() -> None:
    room, pose = voxels(), looking(0.05, 0.05, 1.45)
    clear = np.full((120, 212), 3.0, dtype=np.float32)
    phantom = clear.copy()
    phantom[50:70, 96:116] = 1.52
    for _ in range(3):
        room.integrate(posed(phantom, pose))
    assert (room.snapshot().state[35] == OCCUPIED).any()
    for _ in range(12):
        room.integrate(posed(clear, pose))
    assert not (room.snapshot().state[21:48] == OCCUPIED).any()
    speckle = clear.copy()
    speckle[60, 106] = 1.52
    room.integrate(posed(speckle, pose))
    assert room.snapshot().state[35, 30, 14] == FREE


def test_something_new_in_free_space_is_seen_within_half_a_second() -> None:
    room, pose = voxels(), looking(0.05, 0.05, 1.45)
    for _ in range(50):
        room.integrate(posed(np.full((120, 212), 3.0, dtype=np.float32), pose))
    for _ in range(3):
        room.integrate(posed(np.full((120, 212), 1.52, dtype=np.float32), pose))
    assert room.snapshot().state[35, 30, 14] == OCCUPIED


def test_a_new_obstacle_makes_free_space_behind_it_unknown() -> None:
    """The inside of the new obstacle is not seen, and was free before."""
    room, pose = voxels(), looking(0.05, 0.05, 1.45)
    for _ in range(20):
        room.integrate(posed(np.full((120, 212), 3.0, dtype=np.float32), pose))
    before = room.snapshot().state
    box = np.full((120, 212), 3.0, dtype=np.float32)
    box[40:80, 86:126] = 1.52
    for _ in range(4):
        room.integrate(posed(box, pose))
    state = room.snapshot().state
    assert (before[36:48, 30, 14] == FREE).all()
    assert state[35, 30, 14] == OCCUPIED
    assert (state[36:41, 29:32, 13:16] == UNKNOWN).all()
    assert (state[43:48, 30, 14] == FREE).all(), "no farther than something stands deep"
    np.testing.assert_array_equal(state[36:48, 18, 14], before[36:48, 18, 14], "beside it nothing changes")
    for _ in range(4):
        room.integrate(posed(np.full((120, 212), 3.0, dtype=np.float32), pose))
    assert (room.snapshot().state[36:48, 30, 14] == FREE).all(), "gone again"


def test_noise_in_front_of_a_wall_keeps_the_room_behind_it_free() -> None:
    room, pose = voxels(), looking(0.05, 0.05, 1.45)
    for _ in range(20):
        room.integrate(posed(np.full((120, 212), 3.0, dtype=np.float32), pose))
    room.declare_free(np.array([3.6, 0.05]), 0.35, 1.2, 1.8)
    beyond = room.snapshot().state[53:58, 30, 13:17]
    assert (beyond == FREE).all()
    assert room.snapshot().state[48, 30, 14] == FREE and room.snapshot().state[50, 30, 14] == OCCUPIED
    for _ in range(12):
        room.integrate(posed(np.full((120, 212), 2.8, dtype=np.float32), pose))
    assert room.snapshot().state[48, 30, 14] == OCCUPIED
    np.testing.assert_array_equal(room.snapshot().state[53:58, 30, 13:17], beyond)


def test_declared_space_is_free_until_returns_contradict() -> None:
    room = voxels()
    room.declare_free(np.zeros(3), 0.6, 0.0, 1.2)
    state = room.snapshot().state
    assert (state[15:25, 28:32, :12] == FREE).all() and state[20, 30, 12] == UNKNOWN and state[27, 30, 5] == UNKNOWN
    for _ in range(5):
        room.integrate(posed(np.full((120, 212), 0.55, dtype=np.float32), looking(0.0, 0.05, 0.65)))
    assert room.snapshot().state[25, 30, 6] == OCCUPIED


def test_snapshots_are_frozen_and_counted() -> None:
    room = voxels()
    first = room.snapshot()
    assert room.snapshot() is first
    room.declare_free(np.zeros(3), 0.6, 0.0, 1.2)
    second = room.snapshot()
    assert second.revision > first.revision and (first.state == UNKNOWN).all()
    assert not second.state.flags.writeable
    np.testing.assert_allclose(room.explored_m3(), np.count_nonzero(second.state) * 1e-3)


def test_every_snapshot_equals_one_from_scratch_and_marks_changed_tiles() -> None:
    rng = np.random.default_rng(5)
    room, last, held = voxels(fence_min=(-1.2, -1.4, 0.1)), None, []
    for step in range(40):
        if step % 7 == 3:
            room.declare_free(rng.uniform(-2.5, 3.5, 3), 0.4, 0.3, float(rng.uniform(0.3, 2.0)))
        elif step % 7 == 5:
            x, y, z = rng.uniform([-1, -1, 0.5], [2.5, 1, 2.0])
            room.declare_free(np.array([x, y]), 0.2, z - 0.1, z + 0.1)
        else:
            pose = looking(float(rng.uniform(-1, 2)), float(rng.uniform(-1, 1)), 1.2, float(rng.uniform(-3, 3)))
            depth_m = depth_of_box(pose, *ROOM)
            depth_m[rng.random(depth_m.shape) < 0.02] = np.nan
            room.integrate(posed(depth_m if step % 5 else 0.6 * depth_m, pose))  # sometimes all surfaces are nearer
        picture = room.snapshot()
        np.testing.assert_array_equal(picture.distance2, by_scipy(picture.state, 11))
        assert not room._scratch.hits.counts.any()  # a frame leaves no data for the next one
        known = np.count_nonzero((picture.state != UNKNOWN)[8:, 16:, 1:])
        np.testing.assert_allclose(room.explored_m3(), known * 1e-3)
        if last is not None and last.revision < picture.revision:
            differ = ((picture.state != last.state) | (picture.distance2 != last.distance2)).any(axis=2)
            tiles = np.zeros(picture.tile_revision.shape, dtype=bool)
            tiles[tuple(np.argwhere(differ).T // TILE)] = True
            np.testing.assert_array_equal(picture.changed_tiles(last.revision), np.argwhere(tiles))
            assert (picture.tile_revision[tiles] == picture.revision).all()
        last = picture
        if rng.random() < 0.3:
            held.append((picture, picture.state.copy(), picture.distance2.copy(), picture.tile_revision.copy()))
        if len(held) > 3:
            held.pop(int(rng.integers(3)))
        for kept, state, distance2, dated in held:  # snapshots that are held do not change
            np.testing.assert_array_equal(kept.state, state)
            np.testing.assert_array_equal(kept.distance2, distance2)
            np.testing.assert_array_equal(kept.tile_revision, dated)


def test_a_stride_of_two_uses_every_other_pixel() -> None:
    pose, rng = looking(0.05, 0.05, 1.45), np.random.default_rng(1)
    depth_m = noisy(depth_of_box(pose, *ROOM), rng)
    half = Intrinsics(LENS.fx / 2, LENS.fy / 2, LENS.cx / 2, LENS.cy / 2, 106, 60)
    strided = OccupancyMap(GRID, D435I, 5.0, (-2, -3, 0), (6, 3, 3), 1.1, pixel_stride=2)
    small = voxels()
    for _ in range(4):
        strided.integrate(posed(depth_m, pose))
        small.integrate(posed(depth_m[::2, ::2], pose, half))
    np.testing.assert_array_equal(strided.snapshot().state, small.snapshot().state)
    assert (small.snapshot().state == FREE).any()


@pytest.mark.parametrize("pixels", [(120, 212), (61, 107)])
def test_frees_exactly_the_voxels_that_the_rules_allow(pixels: tuple[int, int]) -> None:
    """One frame with holes and steps, against the rules evaluated voxel by voxel."""
    height, width = pixels
    lens = Intrinsics.from_fov(width, height, np.radians(87), np.radians(58))
    rng = np.random.default_rng(height)
    depth_m = np.kron(rng.uniform(0.6, 6.0, (9, 16)), np.ones((14, 14)))[:height, :width].astype(np.float32)
    depth_m = np.minimum(depth_m, np.linspace(0.5, 6.0, width, dtype=np.float32))  # with a wall along the view direction
    depth_m[rng.random(pixels) < 0.1] = np.nan
    depth_m[: height // 3, : width // 3] = np.nan
    pose = looking(0.03, 0.02, 1.43, 0.4) @ Pose.from_rotation_vector(np.array([-0.3, 0.1, 0.2]), np.zeros(3))
    room = OccupancyMap(GRID, DepthSensor(0.3, 0.02, 0.05), 5.0, (-2, -3, 0), (6, 3, 3), 1.1)
    for _ in range(4):
        room.integrate(posed(depth_m, pose, lens))
    free = room.snapshot().state == FREE
    allowed = np.zeros(GRID.shape, dtype=bool)
    depth_from_world, centres = pose.inverse(), GRID.centre(np.moveaxis(np.indices(GRID.shape), 0, -1))
    extent_m = 0.05 * np.abs(pose.rotation()[:, 2]).sum()
    for index in np.argwhere(np.linalg.norm(centres - pose.translation_m, axis=-1) <= 5.0):
        x, y, z = depth_from_world.apply(centres[tuple(index)])
        if z < 0.1:
            continue
        u, v, r = x / z * lens.fx + lens.cx, y / z * lens.fy + lens.cy, 0.05 * lens.fy / z
        if not (-0.5 < u < width - 0.5 and -0.5 < v < height - 0.5):
            continue
        seen = depth_m[max(round(v - r), 0) : round(v + r) + 1, max(round(u - r), 0) : round(u + r) + 1]
        seen = seen[np.isfinite(seen)]
        if seen.size:
            noise_m = seen.min() - seen.min() / (1 + 2.5 * 0.02 / (lens.fx * 0.05) * seen.min())
            allowed[tuple(index)] = seen.min() - z > max(extent_m, noise_m) - 1e-4
    assert np.count_nonzero(free) > 1000
    assert not (free & ~allowed).any()
    assert np.count_nonzero(free) > 0.5 * np.count_nonzero(allowed)


def test_a_return_in_the_corner_of_a_voxel_outweighs_the_clear_rest() -> None:
    """A return beyond the footprint can lie in the voxel, along its diagonal."""
    lens = Intrinsics.from_fov(424, 240, np.radians(87), np.radians(58))
    index = GRID.index(np.array([1.45, 1.45, 1.45]))
    pose = looking(0.05, 0.05, 1.45, np.radians(45))  # the voxel's centre is 1.98 m straight ahead
    clear = np.full((240, 424), 3.0, dtype=np.float32)
    corner = clear.copy()
    beyond_px = 0.065 / 1.98 * lens.fx  # 0.065 m; half the diagonal is 0.071 m
    corner[116:124, round(lens.cx + beyond_px)] = 1.98
    for depth_m, expected in ((clear, FREE), (corner, OCCUPIED)):
        room = voxels()
        for _ in range(6):
            room.integrate(posed(depth_m, pose, lens))
        assert room.snapshot().state[tuple(index)] == expected


def test_a_new_epoch_starts_unknown_and_refuses_old_frames() -> None:
    room = voxels()
    room.declare_free(np.zeros(3), 0.6, 0.0, 1.2)
    room.reset(1)
    assert (room.snapshot().state == UNKNOWN).all() and room.snapshot().map_epoch == 1
    with pytest.raises(ValueError, match="epoch 0"):
        room.integrate(posed(np.full((120, 212), 1.0, dtype=np.float32), looking(0, 0, 1)))


@pytest.mark.shared
def test_agrees_with_the_reference_stream() -> None:
    lens = Intrinsics(**{k: v / 2 for k, v in zip(("fx", "fy", "cx", "cy"), _lens(), strict=True)}, width=320, height=240)
    with np.load(STREAM / "depth_640x480.npz") as archive:
        depth_mm = archive["depth_mm"][:, ::2, ::2]
    grid = GridSpec(np.array([-5.0, -3.0, 0.0]), 0.1, (100, 60, 30))
    room = OccupancyMap(grid, DepthSensor(0.1, 0.001, 0.05), 4.5, (-5, -3, 0), (5, 3, 3), 1.1)  # 1 mm at 3 m
    room.warm_up()
    took_s = []
    for depth, matrix in zip(depth_mm, np.load(STREAM / "poses.npy"), strict=True):
        depth_m = np.where(depth == 0, 20.0, depth * 1e-3).astype(np.float32)  # this stream's 0 is "beyond range"
        began_s = time.perf_counter()
        room.integrate(posed(depth_m, Pose.from_matrix(matrix), lens))
        took_s.append(time.perf_counter() - began_s)
        if len(took_s) % 10 == 0:
            np.testing.assert_array_equal(room.snapshot().distance2, by_scipy(room.snapshot().state, 11))
    state = room.snapshot().state
    reference = np.fromfile(STREAM / "occupancy_reference.i8", dtype=np.int8).reshape(grid.shape)
    near = [ndimage.binary_dilation(reference == value, ONE_VOXEL) for value in (UNKNOWN, FREE, OCCUPIED)]
    agreed = np.choose(state, near)
    assert agreed.mean() >= 0.992
    assert np.count_nonzero((state == FREE) & (reference == OCCUPIED)) == 0
    # against the scene itself, because the reference lacks thin legs, which it carved away
    i, j, k = np.indices(grid.shape)
    centre = grid.centre(np.stack([i, j, k], axis=-1))
    inside, beside = (
        np.zeros(grid.shape, dtype=bool),
        np.any((centre < [-4.85, -2.85, 0.15]) | (centre > [4.85, 2.85, 2.85]), axis=-1),
    )
    for low, high in np.load(STREAM / "boxes.npy"):
        inside |= np.all((centre > low) & (centre < high), axis=-1)
        beside |= np.all((centre > low - 0.15) & (centre < high + 0.15), axis=-1)
    assert np.count_nonzero(inside & (state == FREE)) == 0
    assert np.count_nonzero((state == OCCUPIED) & ~beside) == 0
    assert np.median(took_s) < 0.01  # 0.4 ms on an idle core


def _lens() -> list[float]:
    meta = json.loads((STREAM / "meta.json").read_text())["640x480"]
    return [meta[key] for key in ("fx", "fy", "cx", "cy")]
