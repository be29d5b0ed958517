"""Generated flats of one to three furnished rooms, and small rooms.

A seed gives the same scene everywhere. Lengths in metres; the origin is the lowest corner of the floor. The outer shell is
closed; doorways have no doors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sitl.scene import furniture, texture
from sitl.scene.furniture import Piece
from sitl.scene.mesh import Mesh, joined
from sitl.scene.primitives import MeshBuilder

DOOR_M = (0.9, 1.6)  # width
NARROWEST_M = 2.0  # minimum width of a room
FREE_START_M = 0.5  # distance from the take-off position to walls and furniture on the floor (not to hanging lamps)
DOORSTEP_M = 0.9  # length kept free on either side of a doorway
PAINT_STEP_M = 0.04
TRIES = 40
Rng = np.random.Generator
Start = tuple[float, float, float, float]
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
KINDS = {"random": FLAT, "small": SMALL_ROOM}  # by the word before the seed in the name of a scene


@dataclass(frozen=True)
class _Area:
    """A rectangle of floor."""

    x0: float
    y0: float
    x1: float
    y1: float

    @property
    def square_m(self) -> float:
        return (self.x1 - self.x0) * (self.y1 - self.y0)

    def touches(self, other: _Area) -> bool:
        return self.x0 < other.x1 and other.x0 < self.x1 and self.y0 < other.y1 and other.y0 < self.y1

    def distance_m(self, x: float, y: float) -> float:
        return math.hypot(max(self.x0 - x, x - self.x1, 0.0), max(self.y0 - y, y - self.y1, 0.0))

    def grown(self, margin_m: float) -> _Area:
        return _Area(self.x0 - margin_m, self.y0 - margin_m, self.x1 + margin_m, self.y1 + margin_m)


class _Flat:
    """A flat under construction: its rooms, the footprints of its contents, and their meshes."""

    def __init__(self, seed: int, fine: bool, kind: RoomKind) -> None:
        self.rng = np.random.default_rng([seed, kind.stream])
        self.builder = MeshBuilder(fine)
        self.furniture_per_m2 = kind.furniture_per_m2
        area, aspect = math.exp(self.rng.uniform(*np.log(kind.area_m2))), self.rng.uniform(*kind.aspect)
        wide = max(math.sqrt(area / aspect), kind.narrowest_m)
        self.length_m = area / wide
        self.width_m = wide
        self.height_m = self.rng.uniform(*kind.height_m)
        self.parts: list[Mesh] = []
        self.standing: list[_Area] = []  # footprints of walls and furniture on the floor
        self.door_areas: list[_Area] = []
        self.rooms = [_Area(0.0, 0.0, self.length_m, self.width_m)]

    # -- walls ----------------------------------------------------------------------------------------------------

    def build_shell(self) -> None:
        """Add the floor, the ceiling and four walls with windows and pictures."""
        x, y, z, w, rng = self.length_m, self.width_m, self.height_m, self.builder, self.rng
        tone = rng.uniform(0.35, 0.7)
        floors = (texture.floor, texture.carpet(tuple(rng.uniform(0.2, 0.6, 3))), texture.tiles((tone, tone, 0.9 * tone), 0.4))
        step = PAINT_STEP_M
        self.parts += [
            w.patch((0, 0, 0), (x, 0, 0), (0, y, 0), floors[int(rng.integers(3))], step),
            w.patch((0, 0, z), (0, y, 0), (x, 0, 0), texture.ceiling, step),
            w.patch((0, 0, 0), (0, 0, z), (x, 0, 0), self._wall_paint(0, x), step),
            w.patch((0, y, 0), (x, 0, 0), (0, 0, z), self._wall_paint(0, x), step),
            w.patch((0, 0, 0), (0, y, 0), (0, 0, z), self._wall_paint(1, y), step),
            w.patch((x, 0, 0), (0, 0, z), (0, y, 0), self._wall_paint(1, y), step),
        ]

    def _wall_paint(self, axis: int, length_m: float) -> texture.Paint:
        rng = self.rng
        windows: list[tuple[float, ...]] = []
        pictures: list[tuple[float, ...]] = []
        at = rng.uniform(0.2, 0.8)
        while at < length_m - 0.8:
            wide = rng.uniform(0.4, 1.2)
            right, top = min(at + wide, length_m - 0.15), min(rng.uniform(1.7, 2.1), self.height_m - 0.15)
            if rng.random() < 0.35:
                windows.append((at, 0.95, right, top))
            else:
                pictures.append((at, rng.uniform(1.0, 1.3), right, top, float(rng.integers(1000))))
            at = right + rng.uniform(0.2, 1.0)
        return texture.wall(tuple(rng.uniform(0.55, 0.85, 3)), axis, windows, pictures)

    def divide(self) -> None:
        """Divide the flat by up to two walls with a doorway each, where rooms are long enough."""
        area = self.length_m * self.width_m
        chances = (1.0, 0.0, 0.0) if area < 15.0 else (0.4, 0.6, 0.0) if area < 30.0 else (0.2, 0.4, 0.4)
        for _ in range(int(self.rng.choice(3, p=chances))):
            room = max(self.rooms, key=lambda r: r.square_m)
            if max(room.x1 - room.x0, room.y1 - room.y0) >= 2 * NARROWEST_M + 0.3:
                self._split(room)

    def _split(self, room: _Area) -> None:
        """Add a wall with a doorway across the longer side of a room."""
        rng, thick = self.rng, self.rng.uniform(0.08, 0.16)
        along_x = room.x1 - room.x0 >= room.y1 - room.y0
        low, high = (room.x0, room.x1) if along_x else (room.y0, room.y1)
        side0, side1 = (room.y0, room.y1) if along_x else (room.x0, room.x1)

        def area(a: float, b: float, c: float, d: float) -> _Area:
            """Return the area from a to b across the wall and from c to d along it."""
            return _Area(a, c, b, d) if along_x else _Area(c, a, d, b)

        at = rng.uniform(low + NARROWEST_M, high - NARROWEST_M - thick)
        if any(area(at, at + thick, side0, side1).touches(other) for other in self.door_areas):
            return  # the wall would block a doorway
        door = min(rng.uniform(*DOOR_M), side1 - side0 - 0.3)
        left = rng.uniform(side0 + 0.1, side1 - door - 0.1)
        lintel = self.height_m if rng.random() < 0.2 else min(rng.uniform(1.98, 2.15), self.height_m)

        for begin, end, bottom in ((side0, left, 0.0), (left + door, side1, 0.0), (left, left + door, lintel)):
            if end - begin > 1e-6 and self.height_m - bottom > 1e-6:
                wall = area(at, at + thick, begin, end)
                paint = self._wall_paint(1 if along_x else 0, side1)
                box = (wall.x0, wall.y0, bottom), (wall.x1, wall.y1, self.height_m)
                self.parts.append(self.builder.box(*box, paint, PAINT_STEP_M))
                if bottom == 0.0:
                    self.standing.append(wall)
        self.door_areas.append(area(at - DOORSTEP_M, at + thick + DOORSTEP_M, left, left + door))
        self.rooms.remove(room)
        self.rooms += [area(low, at, side0, side1), area(at + thick, high, side0, side1)]

    # -- furniture ------------------------------------------------------------------------------------------------

    def furnish(self, room: _Area) -> None:
        """Add furniture at the walls and elsewhere, pillars and lamps, in proportion to the area."""
        rng, w = self.rng, self.builder
        pieces = rng.uniform(*self.furniture_per_m2) * room.square_m
        for _ in range(max(1, round(0.6 * pieces))):
            self._against_a_wall(room, furniture.AT_WALLS[int(rng.integers(len(furniture.AT_WALLS)))](w, rng))
        for _ in range(max(1, round(0.5 * pieces))):
            self._anywhere(room, furniture.ANYWHERE[int(rng.integers(len(furniture.ANYWHERE)))](w, rng))
        if room.square_m > 14.0 and rng.random() < 0.4:
            self._anywhere(room, furniture.pillar(w, rng, self.height_m))
        for _ in range(int(rng.integers(0, 2 + int(room.square_m / 20.0)))):
            lamp = furniture.hanging_lamp(w, rng, self.height_m)
            x, y = rng.uniform(room.x0 + 0.4, room.x1 - 0.4), rng.uniform(room.y0 + 0.4, room.y1 - 0.4)
            self.parts.append(lamp.placed(x, y, 0.0))

    def _against_a_wall(self, room: _Area, piece: Piece) -> None:
        rng = self.rng
        for _ in range(TRIES):
            side = int(rng.integers(4))
            turn = (0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi)[side]  # backs to the walls y0, x1, y1, x0
            half_x, half_y = piece.reach(turn)
            if 2 * half_x > room.x1 - room.x0 or 2 * half_y > room.y1 - room.y0:
                continue
            x, y = rng.uniform(room.x0 + half_x, room.x1 - half_x), rng.uniform(room.y0 + half_y, room.y1 - half_y)
            x = (x, room.x1 - half_x - 0.01, x, room.x0 + half_x + 0.01)[side]
            y = (room.y0 + half_y + 0.01, y, room.y1 - half_y - 0.01, y)[side]
            if self._place(room, piece, x, y, turn, 0.02):
                return

    def _anywhere(self, room: _Area, piece: Piece) -> None:
        rng = self.rng
        for _ in range(TRIES):
            turn = rng.choice([0.0, 0.5 * math.pi, rng.uniform(-math.pi, math.pi)])
            x, y = rng.uniform(room.x0, room.x1), rng.uniform(room.y0, room.y1)
            if self._place(room, piece, x, y, float(turn), float(rng.choice([0.05, 0.3, 0.8]))):
                return

    def _place(self, room: _Area, piece: Piece, x: float, y: float, turn_rad: float, gap_m: float) -> bool:
        """Place a piece if it fits into the room with the gap to other pieces; return True if so."""
        half_x, half_y = piece.reach(turn_rad)
        place = _Area(x - half_x, y - half_y, x + half_x, y + half_y)
        inside = place.x0 >= room.x0 and place.y0 >= room.y0 and place.x1 <= room.x1 and place.y1 <= room.y1
        wide = place.grown(gap_m)
        if not inside or any(wide.touches(other) for other in (*self.standing, *self.door_areas)):
            return False
        self.standing.append(place)
        self.parts.append(piece.placed(x, y, turn_rad))
        return True

    def start(self) -> Start | None:
        """Return a random start X, Y, Z (m), YAW (degrees) with FREE_START_M around it, or None."""
        margin = FREE_START_M + 0.02
        for _ in range(50 * TRIES):
            x = self.rng.uniform(margin, self.length_m - margin)
            y = self.rng.uniform(margin, self.width_m - margin)
            yaw = self.rng.uniform(-180.0, 180.0)
            if all(area.distance_m(x, y) >= margin for area in self.standing):
                return float(x), float(y), 1.2, float(yaw)
        return None


def generated_room(seed: int, fine: bool = True, kind: RoomKind = FLAT) -> tuple[Mesh, Start]:
    """Return the scene of a seed (0 or more) and a start X, Y, Z (m), YAW (degrees) in it.

    A scene without free space for a start is drawn again. fine: with texture, which takes about a second.
    """
    again = 0
    while True:
        flat = _Flat(seed + (again << 32), fine, kind)
        flat.divide()
        flat.build_shell()
        for room in flat.rooms:
            flat.furnish(room)
        start = flat.start()
        if start is not None:
            return joined(flat.parts), start
        again += 1
