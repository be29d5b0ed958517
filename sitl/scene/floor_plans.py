"""Floor plans of ordinary buildings: doors, a corridor, a hall, an L, a dead end.

The rooms of a plan and its doorways are given; everything else of its length and width is wall. A seed furnishes the rooms.
Lengths in metres.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from sitl.scene.flat_builder import DOORSTEP_M, Area, FlatBuilder, Start
from sitl.scene.mesh import Mesh, joined

WALL_M = 0.1
LINTEL_M = 2.0
FURNITURE_PER_M2 = (0.12, 0.25)
STREAM = 0xF100


@dataclass(frozen=True)
class FloorPlan:
    """Rooms and the doorways between them.

    rooms and doorways: X0, Y0, X1, Y1. A doorway fills the wall that it leads through, up to lintel_m. furniture_per_m2: range
    of the number of pieces. start: X, Y (m) and YAW (degrees) of the take-off.
    """

    rooms: tuple[tuple[float, float, float, float], ...]
    doorways: tuple[tuple[float, float, float, float], ...]
    start: tuple[float, float, float]
    height_m: float = 2.5
    lintel_m: float = LINTEL_M
    furniture_per_m2: tuple[float, float] = FURNITURE_PER_M2

    def build(self, seed: int, fine: bool = True) -> tuple[Mesh, Start]:
        """Return the furnished scene of a seed and a start X, Y, Z (m), YAW (degrees)."""
        rooms, doorways = [Area(*room) for room in self.rooms], [Area(*doorway) for doorway in self.doorways]
        rng = np.random.default_rng([seed, STREAM])
        flat = FlatBuilder(rng, fine, max(room.x1 for room in rooms), max(room.y1 for room in rooms), self.height_m)
        for wall in _solid(flat.length_m, flat.width_m, [*rooms, *doorways]):
            flat.add_wall(wall, 0.0, 0 if wall.x1 - wall.x0 > wall.y1 - wall.y0 else 1, max(wall.x1, wall.y1))
        for doorway in doorways:
            flat.door_areas.append(doorway.grown(DOORSTEP_M))
            if self.lintel_m < self.height_m:
                along_x = doorway.x1 - doorway.x0 > doorway.y1 - doorway.y0
                flat.add_wall(doorway, self.lintel_m, 0 if along_x else 1, 0.0)
        x, y, yaw_deg = self.start
        flat.door_areas.append(Area(x, y, x, y).grown(DOORSTEP_M))
        flat.rooms = rooms
        flat.build_shell()
        for room in rooms:
            flat.furnish(room, self.furniture_per_m2)
        return joined(flat.parts), (x, y, 1.2, yaw_deg)


def two_rooms(door_m: float) -> FloorPlan:
    """Return two rooms of 4 x 4 m and a doorway at a third of the wall between them."""
    low = 1.35 - 0.5 * door_m
    return FloorPlan(
        rooms=((0.0, 0.0, 4.0, 4.0), (4.0 + WALL_M, 0.0, 8.0 + WALL_M, 4.0)),
        doorways=((4.0, low, 4.0 + WALL_M, low + door_m),),
        start=(1.3, 2.4, 20.0),
    )


CORRIDOR = FloorPlan(
    rooms=((0.0, 0.0, 15.0, 1.6), (1.0, 1.6 + WALL_M, 6.0, 5.2), (8.0, 1.6 + WALL_M, 14.0, 5.2)),
    doorways=((3.0, 1.6, 3.9, 1.6 + WALL_M), (11.5, 1.6, 12.4, 1.6 + WALL_M)),
    start=(1.2, 0.8, 0.0),
)
HALL = FloorPlan(rooms=((0.0, 0.0, 12.0, 8.0),), doorways=(), start=(2.0, 2.0, 45.0), height_m=3.2)
L_SHAPE = FloorPlan(rooms=((0.0, 0.0, 7.0, 2.6), (0.0, 2.6, 2.8, 8.0)), doorways=(), start=(5.5, 1.3, 180.0))
DEAD_END = FloorPlan(
    rooms=((0.0, 0.0, 4.0, 4.0), (4.0 + WALL_M, 1.4, 10.0, 2.6)),
    doorways=((4.0, 1.6, 4.0 + WALL_M, 2.4),),
    start=(1.5, 2.0, 0.0),
)
TALL = FloorPlan(
    rooms=((0.0, 0.0, 5.0, 4.0), (5.0 + WALL_M, 0.0, 9.0, 4.0)),
    doorways=((5.0, 1.5, 5.0 + WALL_M, 2.3),),
    start=(1.5, 2.0, 0.0),
    height_m=4.0,
)


def _solid(length_m: float, width_m: float, free: list[Area]) -> list[Area]:
    """Return rectangles that cover what is in no free area, joined along y."""
    xs = sorted({0.0, length_m, *(x for area in free for x in (area.x0, area.x1))})
    ys = sorted({0.0, width_m, *(y for area in free for y in (area.y0, area.y1))})
    found: list[Area] = []
    for x0, x1 in itertools.pairwise(xs):
        begin: float | None = None
        for y0, y1 in [*itertools.pairwise(ys), (width_m, width_m)]:
            wall = y0 < y1 and not any(area.distance_m(0.5 * (x0 + x1), 0.5 * (y0 + y1)) == 0.0 for area in free)
            if wall and begin is None:
                begin = y0
            elif not wall and begin is not None:
                found.append(Area(x0, begin, x1, y0))
                begin = None
    return found
