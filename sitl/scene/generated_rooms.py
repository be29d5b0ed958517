"""Generated flats of one to three furnished rooms, and small rooms.

A seed gives the same scene everywhere. Lengths in metres; doorways have no doors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sitl.scene.flat_builder import Area, FlatBuilder, Start
from sitl.scene.mesh import Mesh, joined

DOOR_M = (0.9, 1.6)  # width
NARROWEST_M = 2.0  # minimum width of a room
Range = tuple[float, float]


@dataclass(frozen=True)
class RoomKind:
    """The ranges from which the scenes of a kind are drawn.

    furniture_per_m2: pieces of furniture, before those that do not fit. narrowest_m: minimum width of the scene.
    stream: makes the draws of a seed differ between kinds.
    """

    area_m2: Range
    height_m: Range
    aspect: Range
    furniture_per_m2: Range
    narrowest_m: float
    stream: int


FLAT = RoomKind((12.0, 70.0), (2.3, 3.2), (1.0, 2.2), (0.12, 0.32), NARROWEST_M + 0.3, 0xF1A7)
SMALL_ROOM = RoomKind((6.0, 14.0), (2.3, 2.7), (1.0, 1.7), (0.5, 0.9), 1.9, 0x5A11)


def generated_room(seed: int, fine: bool = True, kind: RoomKind = FLAT) -> tuple[Mesh, Start]:
    """Return the scene of a seed (0 or more) and a start X, Y, Z (m), YAW (degrees) in it.

    A scene without free space for a start is drawn again. fine: with texture, which takes about a second.
    """
    again = 0
    while True:
        rng = np.random.default_rng([seed + (again << 32), kind.stream])
        area, aspect = math.exp(rng.uniform(*np.log(kind.area_m2))), rng.uniform(*kind.aspect)
        wide = max(math.sqrt(area / aspect), kind.narrowest_m)
        flat = FlatBuilder(rng, fine, area / wide, wide, rng.uniform(*kind.height_m))
        _divide(flat)
        flat.build_shell()
        for room in flat.rooms:
            flat.furnish(room, kind.furniture_per_m2)
        start = flat.start()
        if start is not None:
            return joined(flat.parts), start
        again += 1


def _divide(flat: FlatBuilder) -> None:
    """Divide the flat by up to two walls with a doorway each, where rooms are long enough."""
    area = flat.length_m * flat.width_m
    chances = (1.0, 0.0, 0.0) if area < 15.0 else (0.4, 0.6, 0.0) if area < 30.0 else (0.2, 0.4, 0.4)
    for _ in range(int(flat.rng.choice(3, p=chances))):
        room = max(flat.rooms, key=lambda r: r.square_m)
        if max(room.x1 - room.x0, room.y1 - room.y0) >= 2 * NARROWEST_M + 0.3:
            _split(flat, room)


def _split(flat: FlatBuilder, room: Area) -> None:
    """Add a wall with a doorway across the longer side of a room."""
    rng, thick_m = flat.rng, flat.rng.uniform(0.08, 0.16)
    across = 0 if room.x1 - room.x0 >= room.y1 - room.y0 else 1
    (low, high), (side0, side1) = room.span(across), room.span(1 - across)

    at = rng.uniform(low + NARROWEST_M, high - NARROWEST_M - thick_m)
    if any(Area.across(across, at, at + thick_m, side0, side1).touches(other) for other in flat.door_areas):
        return  # the wall would block a doorway
    door_m = min(rng.uniform(*DOOR_M), side1 - side0 - 0.3)
    left = rng.uniform(side0 + 0.1, side1 - door_m - 0.1)
    lintel_m = flat.height_m if rng.random() < 0.2 else min(rng.uniform(1.98, 2.15), flat.height_m)
    flat.divide(room, across, at, thick_m, left, door_m, lintel_m)
