"""Generated flats with doors: widths, leaves, closed shells, and every room within reach.

Widths and reach are measured in the mesh, on grids of their own.
"""

from __future__ import annotations

import hashlib
import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from sitl.scene import door_leaf, flats_with_doors
from sitl.scene.door_leaf import LEAF_M, Doorway, free_width_m, open_leaf
from sitl.scene.flat_builder import Area
from sitl.scene.flats_with_doors import FlatWithDoors, draw_flat
from sitl.scene.generated_rooms import generated_room
from sitl.scene.mesh import Mesh, joined
from sitl.scene.scene import load_scene

SEEDS = range(50)
STEP_M = 0.004
NEED_M = 0.4 + 2 * 0.12  # hull and the space on each side of it
HEIGHTS_M = (0.78, 1.22)  # of what the vehicle passes: hull of 0.2 m at 1 m, and 0.12 m above and below
UNCHANGED = {
    0: "4074078557539274", 1: "c211569c6d6bde4f", 7: "899b4b4dd5faef55", 19: "9fd7f20b79049c66",
}  # fmt: skip

F64 = NDArray[np.float64]
Flat = tuple[FlatWithDoors, tuple[float, float, float, float], Mesh, F64]


@pytest.fixture(scope="module")
def flats() -> dict[int, Flat]:
    found = {}
    for seed in SEEDS:
        flat, start = draw_flat(seed, fine=False)
        mesh = joined(flat.flat.parts)
        found[seed] = flat, start, mesh, np.concatenate([section(mesh, z) for z in np.arange(0.06, 1.9, 0.06)])
    return found


def section(mesh: Mesh, z: float) -> F64:
    """Points (N, 3) at most STEP_M apart on the lines in which a mesh crosses a height."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    above = corners[:, :, 2] > z
    cut, above = corners[above.any(axis=1) & ~above.all(axis=1)], above[above.any(axis=1) & ~above.all(axis=1)]
    alone = np.argmax(above == (above.sum(axis=1) == 1)[:, None], axis=1)  # the corner on a side of its own
    tip = cut[np.arange(len(cut)), alone]
    ends = []
    for other in (1, 2):
        base = cut[np.arange(len(cut)), (alone + other) % 3]
        ends.append(tip + ((z - tip[:, 2]) / (base[:, 2] - tip[:, 2]))[:, None] * (base - tip))
    count = np.ceil(np.linalg.norm(ends[1] - ends[0], axis=1) / STEP_M).astype(int) + 1
    line = np.repeat(np.arange(len(cut)), count)
    share = (np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)) / np.maximum(count - 1, 1)[line]
    found: F64 = ends[0][line] + share[:, None] * (ends[1] - ends[0])[line]
    return found


def room_to_pass_m(points: F64, low: F64, high: F64, cell_m: float) -> F64:
    """Distance (nx, ny) of the cells between two corners (2,) to the nearest point of the mesh at the vehicle's height."""
    beside = (points[:, :2] > low) & (points[:, :2] < high)
    level = points[beside.all(axis=1) & (points[:, 2] > HEIGHTS_M[0]) & (points[:, 2] < HEIGHTS_M[1]), :2]
    shape = np.ceil((high - low) / cell_m).astype(int)
    taken = np.zeros(shape, dtype=bool)
    taken[tuple(((level - low) / cell_m).astype(int).T)] = True
    found: F64 = ndimage.distance_transform_edt(~taken) * cell_m
    return found


def leads_through(points: F64, doorway: Doorway, width_m: float) -> bool:
    """True if a disc gets from one side of a doorway to the other, within 1.2 m of it."""
    cell_m, across, area = 0.005, doorway.across, doorway.area
    low, high = np.array([area.x0, area.y0]) - 1.2, np.array([area.x1, area.y1]) + 1.2
    labels, _ = ndimage.label(room_to_pass_m(points, low, high, cell_m) > width_m / 2)
    labels = labels if across == 0 else labels.T
    through, along = (low[a] + cell_m * np.arange(n) for a, n in zip((across, 1 - across), labels.shape, strict=True))
    (begin, end), (left, right) = area.span(across), area.span(1 - across)
    way = labels[np.ix_((through > begin) & (through < end), (along > left) & (along < right))]
    return bool(
        set(np.unique(way)) & set(np.unique(labels[through < begin - 0.9])) & set(np.unique(labels[through > end + 0.9])) - {0}
    )


def test_random_flats_are_the_same_as_ever() -> None:
    for seed, known in UNCHANGED.items():
        mesh, start = generated_room(seed, fine=False)
        assert hashlib.sha256(mesh.vertices.tobytes() + mesh.faces.tobytes() + repr(start).encode()).hexdigest()[:16] == known


def test_a_seed_gives_the_same_flat(flats: dict[int, Flat]) -> None:
    flat, start = draw_flat(7, fine=False)
    assert start == flats[7][1]
    assert joined(flat.flat.parts).vertices.tobytes() == flats[7][2].vertices.tobytes()
    assert len({start for _, start, _, _ in flats.values()}) == len(SEEDS)


def test_doorways_are_as_wide_as_those_of_dwellings(flats: dict[int, Flat]) -> None:
    """Their width is read from the mesh: between the surfaces that are nearest to the middle, in the wall."""
    widths = []
    for flat, _, mesh, points in flats.values():
        for doorway in flat.doorways:
            (low, high), (begin, end) = doorway.area.span(doorway.across), doorway.area.span(1 - doorway.across)
            through, along, middle = points[:, doorway.across], points[:, 1 - doorway.across], (begin + end) / 2
            in_wall = (through > low + LEAF_M) & (through < high - LEAF_M)
            there = along[in_wall & (np.abs(along - middle) < 0.7) & (points[:, 2] < 1.2)]
            widths.append(there[there > middle].min() - there[there < middle].max())
            x, y = (doorway.area.x0 + doorway.area.x1) / 2, (doorway.area.y0 + doorway.area.y1) / 2
            above_m = height_above(mesh, x, y, 0.5)
            assert 1.95 - 1e-4 <= above_m <= 2.1 + 1e-4
    assert min(widths) >= 0.65 - 1e-4
    assert max(widths) <= 1.2 + 1e-4
    assert 0.7 < np.median(widths) < 0.9


def height_above(mesh: Mesh, x: float, y: float, z: float) -> float:
    """The height of the lowest box that is above a point."""
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    low, high = corners[:, :, :2].min(axis=1), corners[:, :, :2].max(axis=1)
    over = ((low <= (x, y)) & (high >= (x, y))).all(axis=1)
    heights_m = corners[:, 0, 2]
    level = np.ptp(corners[:, :, 2], axis=1) < 1e-6
    return float(heights_m[over & level & (heights_m > z)].min())


def test_the_way_past_every_leaf_is_wide_enough(flats: dict[int, Flat]) -> None:
    for seed, (flat, _, _, points) in flats.items():
        for doorway in flat.doorways:
            assert leads_through(points, doorway, 0.65 - 0.015), f"flat:{seed}"  # the cells blur both sides
            assert not leads_through(points, doorway, doorway.width_m + 0.015), f"flat:{seed}"


def test_a_third_of_the_doorways_have_a_leaf(flats: dict[int, Flat]) -> None:
    doorways = [one for flat, *_ in flats.values() for one in flat.doorways]
    leaves = [one for flat, *_ in flats.values() for one in flat.leaves]
    assert 0.25 < len(leaves) / len(doorways) < 0.42
    for leaf in leaves:
        sides = np.linalg.norm(np.roll(leaf.corners, -1, axis=0) - leaf.corners, axis=1)
        assert sides[[1, 3]] == pytest.approx(LEAF_M)
        assert min(abs(sides[0] - one.width_m) for one in doorways) < 1e-6


def test_every_room_can_be_reached(flats: dict[int, Flat]) -> None:
    for seed, (flat, start, _, points) in flats.items():
        cell_m, size = 0.01, np.array([flat.flat.length_m, flat.flat.width_m])
        room_m = room_to_pass_m(points, np.full(2, -0.02), size + 0.02, cell_m)
        labels, _ = ndimage.label(room_m > NEED_M / 2 - 0.01)  # the cells blur a width by 1 cm at each side
        here = labels[tuple(((np.array(start[:2]) + 0.02) / cell_m).astype(int))]
        assert here, f"flat:{seed}: the start is not free"
        for room in flat.flat.rooms:
            low, high = ((np.array(p) + 0.02) / cell_m for p in ((room.x0, room.y0), (room.x1, room.y1)))
            part = labels[int(low[0]) : int(high[0]), int(low[1]) : int(high[1])]
            assert (part == here).sum() * cell_m**2 > 0.5, f"flat:{seed}: a room cannot be reached"


def test_doorsteps_and_the_swing_of_leaves_are_free(flats: dict[int, Flat]) -> None:
    for seed, (flat, _, _, points) in flats.items():
        level = points[:, :2]
        for leaf in flat.leaves:
            level = level[~inside(level, leaf.footprint.grown(0.01))]
        for doorway in flat.doorways:
            across, (begin, end) = doorway.across, doorway.area.span(1 - doorway.across)
            low, high = doorway.area.span(across)
            free = Area.across(across, low - 0.6, high + 0.6, begin + 0.01, end - 0.01)
            assert not inside(level, free).any(), f"flat:{seed}"
        for leaf in flat.leaves:
            assert not inside(level, leaf.swept.grown(-0.01)).any(), f"flat:{seed}"


def inside(points: F64, area: Area) -> NDArray[np.bool_]:
    x, y = points[:, 0], points[:, 1]
    found: NDArray[np.bool_] = (x > area.x0) & (x < area.x1) & (y > area.y0) & (y < area.y1)
    return found


def test_the_shell_and_every_leaf_are_closed(flats: dict[int, Flat]) -> None:
    for flat, _, mesh, _ in flats.values():
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        corners = mesh.vertices[mesh.faces].astype(np.float64)
        for axis in range(3):
            for border in (low, high):
                lying = corners[(np.abs(corners[:, :, axis] - border[axis]) < 1e-6).all(axis=1)]
                areas = 0.5 * np.linalg.norm(np.cross(lying[:, 1] - lying[:, 0], lying[:, 2] - lying[:, 0]), axis=1)
                side = np.delete(high - low, axis).astype(np.float64)
                assert (np.abs(areas - 0.5 * side.prod()) < 1e-3).sum() == 2
        for leaf in flat.leaves:
            height_m = volume_m3(leaf.mesh(flat.flat.builder, lambda p: p, 2.0)) / (LEAF_M * leaf_width_m(leaf))
            assert height_m == pytest.approx(2.0 - 2 * door_leaf.GAP_M, rel=1e-3)


def leaf_width_m(leaf: door_leaf.DoorLeaf) -> float:
    return float(np.linalg.norm(leaf.corners[1] - leaf.corners[0]))


def volume_m3(mesh: Mesh) -> float:
    """The volume within a closed mesh whose faces look outwards."""
    a, b, c = mesh.vertices[mesh.faces].astype(np.float64).transpose(1, 0, 2)
    return float((a * np.cross(b, c)).sum() / 6.0)


def test_there_is_room_to_take_off(flats: dict[int, Flat]) -> None:
    for _, start, _, points in flats.values():
        standing = points[points[:, 2] < 1.45]
        assert np.linalg.norm(standing[:, :2] - np.array(start[:2]), axis=1).min() >= 0.5


def test_a_flat_is_loaded_as_a_scene() -> None:
    for seed in range(2):
        scene = load_scene(f"flat:{seed}", radius_m=0.30, fine=False)
        assert scene.name == f"flat-{seed}"


@pytest.mark.parametrize("across", [0, 1])
@pytest.mark.parametrize("hinge_low", [False, True])
@pytest.mark.parametrize("beyond", [False, True])
def test_the_free_width_beside_a_leaf(across: int, hinge_low: bool, beyond: bool) -> None:
    """A leaf of 0.9 m leaves 0.9 sin(angle) less its thickness, and at 90 degrees the thickness alone is missing."""
    doorway = Doorway(Area.across(across, 3.0, 3.1, 1.5, 2.4), across)
    room = Area.across(across, 3.1, 7.0, 0.0, 4.0) if beyond else Area.across(across, 0.0, 3.0, 0.0, 4.0)
    for deg in (40.0, 60.0, 90.0):
        leaf = open_leaf(doorway, room, hinge_low, math.radians(deg))
        expected_m = 0.9 * math.sin(math.radians(deg)) - LEAF_M
        assert free_width_m(leaf, doorway, room, hinge_low) == pytest.approx(expected_m, abs=1e-9)
        at_hinge = leaf.corners[0, 1 - across]
        assert at_hinge == pytest.approx(1.5 if hinge_low else 2.4)
        outside = leaf.corners[1, across] > 3.1 if beyond else leaf.corners[1, across] < 3.0
        assert outside, "the leaf opens into the room"


def test_a_leaf_near_the_side_of_a_room_is_measured_against_it() -> None:
    doorway = Doorway(Area(3.0, 0.1, 3.1, 1.0), 0)
    room = Area(3.1, 0.0, 7.0, 4.0)
    leaf = open_leaf(doorway, room, False, math.radians(55.0))  # its tip leans towards the side at y = 0
    assert free_width_m(leaf, doorway, room, False) == pytest.approx(1.0 - 0.9 * math.cos(math.radians(55.0)), abs=0.04)
    struck = open_leaf(doorway, room, True, math.radians(100.0))  # past the side
    assert free_width_m(struck, doorway, room, True) == 0.0


def test_leaves_are_open_by_the_documented_angles(flats: dict[int, Flat]) -> None:
    for flat, *_ in flats.values():
        for leaf in flat.leaves:
            (angle,) = (deg for doorway in flat.doorways if (deg := angle_deg(leaf, doorway)) is not None)
            assert 30.0 <= angle <= 100.0


def angle_deg(leaf: door_leaf.DoorLeaf, doorway: Doorway) -> float | None:
    """The angle between an open leaf and the opening that it would close, None if it hangs in another one."""
    across, hinge, tip = doorway.across, leaf.corners[0], leaf.corners[1]
    (low, high), (begin, end) = doorway.area.span(across), doorway.area.span(1 - across)
    if not (np.isclose(hinge[across], (low, high)).any() and np.isclose(hinge[1 - across], (begin, end)).any()):
        return None
    other = end if np.isclose(hinge[1 - across], begin) else begin
    closed = np.zeros(2)
    closed[1 - across] = other - hinge[1 - across]
    return math.degrees(math.acos(closed @ (tip - hinge) / np.linalg.norm(closed) / np.linalg.norm(tip - hinge)))


def test_a_flat_whose_rooms_cannot_be_reached_is_drawn_again(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = iter([False, False, True])
    monkeypatch.setattr(flats_with_doors.FlatWithDoors, "reached", lambda self, start: next(answers))
    _, start = draw_flat(3, fine=False)
    assert not list(answers)
    monkeypatch.undo()
    assert start != draw_flat(3, fine=False)[1]
