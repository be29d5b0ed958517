"""Generated flats of two to six furnished rooms with ordinary doors, some of them half open.

A seed gives the same scene everywhere. Lengths in metres. Every room can be reached by a vehicle that needs LEAST_FREE_M.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sitl.scene import texture
from sitl.scene.door_leaf import DoorLeaf, Doorway, free_width_m, leaf_distance_m, open_leaf
from sitl.scene.flat_builder import TRIES, Area, FlatBuilder, Start
from sitl.scene.generated_rooms import NARROWEST_M
from sitl.scene.mesh import Mesh, joined

AREA_M2 = (20.0, 75.0)
HEIGHT_M = (2.35, 2.8)
ASPECT = (1.0, 1.8)
LARGEST_ROOM_M2 = (9.0, 22.0)  # a larger room is divided
MOST_WALLS = 5
FURNITURE_PER_M2 = (0.12, 0.32)
DOOR_M = (0.65, 0.9)  # width of a door
PASSAGE_M = (0.9, 1.2)  # ... of an opening without a door
PASSAGE_SHARE = 0.25
LINTEL_M = (1.95, 2.1)
LEAF_SHARE = 0.4  # of openings for which a leaf is tried; it does not fit into some
LEAF_DEG = (30.0, 100.0)
LEAF_DOOR_M = (0.72, 0.95)  # width of a door that has a leaf: less than the first would leave too little free
LEAST_FREE_M = 0.65
JAMB_M = 0.1  # wall beside a door
BESIDE_LEAF_M = 0.65  # from a leaf to other doorways and leaves
CELL_M = 0.02  # of the check that every room can be reached
RADIUS_M = 0.31  # ... of what must pass: half of LEAST_FREE_M, less what the cells take off
REACHED_SHARE = 0.5  # of the free floor of a room, by which it counts as reached
STREAM = 0xD008
BoolGrid = NDArray[np.bool_]


class FlatWithDoors:
    """A flat with its doorways and the leaves in them."""

    def __init__(self, rng: np.random.Generator, fine: bool) -> None:
        """Draw a flat. It may have rooms that cannot be reached, or none to start in."""
        area, aspect = math.exp(rng.uniform(*np.log(AREA_M2))), rng.uniform(*ASPECT)
        wide = math.sqrt(area / aspect)
        self.rng = rng
        self.flat = flat = FlatBuilder(rng, fine, area / wide, wide, rng.uniform(*HEIGHT_M))
        self.doorways: list[Doorway] = []
        self.leaves: list[DoorLeaf] = []
        self._with_leaf: list[tuple[Doorway, float]] = []  # doorways for which a leaf is tried, and their height
        self._divide()
        for doorway, height_m in self._with_leaf:
            self._hang_leaf(doorway, height_m)
        flat.no_lamps += flat.door_areas
        flat.build_shell()
        for room in flat.rooms:
            flat.furnish(room, FURNITURE_PER_M2)

    def _divide(self) -> None:
        """Divide the largest room until all are small enough."""
        largest_m2 = self.rng.uniform(*LARGEST_ROOM_M2)
        for _ in range(TRIES):
            room = max(self.flat.rooms, key=lambda r: r.square_m)
            small = room.square_m <= largest_m2 and self.doorways
            if small or len(self.doorways) == MOST_WALLS or max(room.x1 - room.x0, room.y1 - room.y0) < 2 * NARROWEST_M + 0.3:
                return
            self._split(room)

    def _split(self, room: Area) -> None:
        """Add a wall with a doorway across the longer side of a room, if it blocks no other."""
        rng, thick_m = self.rng, self.rng.uniform(0.08, 0.16)
        across = 0 if room.x1 - room.x0 >= room.y1 - room.y0 else 1
        (low, high), (side0, side1) = room.span(across), room.span(1 - across)
        at = rng.uniform(low + NARROWEST_M, high - NARROWEST_M - thick_m)
        wall = Area.across(across, at, at + thick_m, side0, side1)
        if any(wall.touches(other) for other in self.flat.door_areas):
            return
        has_leaf, is_passage = rng.random() < LEAF_SHARE, rng.random() < PASSAGE_SHARE
        door_m = rng.uniform(*(LEAF_DOOR_M if has_leaf else PASSAGE_M if is_passage else DOOR_M))
        left, lintel_m = rng.uniform(side0 + JAMB_M, side1 - door_m - JAMB_M), rng.uniform(*LINTEL_M)
        doorway = Doorway(self.flat.divide(room, across, at, thick_m, left, door_m, lintel_m), across)
        self.doorways.append(doorway)
        if has_leaf:
            self._with_leaf.append((doorway, lintel_m))

    def _hang_leaf(self, doorway: Doorway, height_m: float) -> None:
        """Add a leaf, if one at some angle leaves enough free, here and at other doorways."""
        rng, flat = self.rng, self.flat
        beside = [room for room in flat.rooms if room.touches(doorway.area.grown(0.01))]
        others = [one.area.grown(BESIDE_LEAF_M) for one in self.doorways if one is not doorway]
        others += [one.footprint.grown(BESIDE_LEAF_M) for one in self.leaves]
        paint = texture.wood(tuple(rng.uniform(0.5, 0.85) * np.array([1.0, 0.85, 0.7])))
        for _ in range(TRIES):
            room, hinge_low = beside[int(rng.integers(len(beside)))], bool(rng.random() < 0.5)
            leaf = open_leaf(doorway, room, hinge_low, math.radians(rng.uniform(*LEAF_DEG)))
            if any(leaf.footprint.touches(other) for other in others):
                continue
            if free_width_m(leaf, doorway, room, hinge_low) >= LEAST_FREE_M:
                self.leaves.append(leaf)
                flat.parts.append(leaf.mesh(flat.builder, paint, height_m))
                flat.standing.append(leaf.footprint)
                flat.door_areas.append(leaf.swept)
                return

    def reached(self, start: Start) -> bool:
        """Return True if every room can be reached from a start."""
        flat = self.flat
        x, y = (np.arange(0.5 * CELL_M, end, CELL_M) for end in (flat.length_m, flat.width_m))
        free = self._free(x, y)
        labels, _ = ndimage.label(free)
        there = labels[int(start[0] / CELL_M), int(start[1] / CELL_M)]
        for room in flat.rooms:
            inside = np.ix_((x > room.x0) & (x < room.x1), (y > room.y0) & (y < room.y1))
            if not there or (labels[inside] == there).sum() <= REACHED_SHARE * max(int(free[inside].sum()), 1):
                return False
        return True

    def _free(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> BoolGrid:
        """Return where (len(x), len(y)) the middle of the vehicle may be."""
        flat = self.flat
        outer = np.minimum(np.minimum(x, flat.length_m - x)[:, None], np.minimum(y, flat.width_m - y)[None, :])
        free: BoolGrid = outer > RADIUS_M
        leaves = {leaf.footprint for leaf in self.leaves}
        for area in (area for area in flat.standing if area not in leaves):
            away_x = np.maximum(np.maximum(area.x0 - x, x - area.x1), 0.0)
            away_y = np.maximum(np.maximum(area.y0 - y, y - area.y1), 0.0)
            free &= np.hypot(away_x[:, None], away_y[None, :]) > RADIUS_M
        for leaf in self.leaves:
            near = leaf.footprint.grown(RADIUS_M)
            some = np.ix_(np.flatnonzero((x > near.x0) & (x < near.x1)), np.flatnonzero((y > near.y0) & (y < near.y1)))
            points = np.stack(np.meshgrid(x[some[0][:, 0]], y[some[1][0]], indexing="ij"), axis=-1)
            free[some] &= leaf_distance_m(leaf, points.reshape(-1, 2)).reshape(points.shape[:2]) > RADIUS_M
        return free


def flat_with_doors(seed: int, fine: bool = True) -> tuple[Mesh, Start]:
    """Return the scene of a seed (0 or more) and a start X, Y, Z (m), YAW (degrees) in it.

    fine: with texture, which takes about a second.
    """
    flat, start = draw_flat(seed, fine)
    return joined(flat.flat.parts), start


def draw_flat(seed: int, fine: bool) -> tuple[FlatWithDoors, Start]:
    """Return the flat of a seed and a start in it.

    One with a room that cannot be reached is drawn again.
    """
    again = 0
    while True:
        flat = FlatWithDoors(np.random.default_rng([seed + (again << 32), STREAM]), fine)
        start = flat.flat.start()
        if start is not None and flat.reached(start):
            return flat, start
        again += 1
