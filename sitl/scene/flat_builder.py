"""A flat under construction: shell, inner walls, doorways, furniture, take-off place.

Lengths in metres; the origin is the lowest corner of the floor. The outer shell is closed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sitl.scene import furniture, texture
from sitl.scene.furniture import Piece
from sitl.scene.mesh import Mesh
from sitl.scene.primitives import MeshBuilder

FREE_START_M = 0.5  # distance from the take-off position to walls and furniture on the floor (not to hanging lamps)
DOORSTEP_M = 0.9  # length kept free on either side of a doorway
PAINT_STEP_M = 0.04
TRIES = 40
Rng = np.random.Generator
Start = tuple[float, float, float, float]


@dataclass(frozen=True)
class Area:
    """A rectangle of floor."""

    x0: float
    y0: float
    x1: float
    y1: float

    @classmethod
    def across(cls, axis: int, low: float, high: float, begin: float, end: float) -> Area:
        """Return the area from low to high along an axis, 0 = x, and from begin to end beside it."""
        return cls(low, begin, high, end) if axis == 0 else cls(begin, low, end, high)

    @property
    def square_m(self) -> float:
        """Area, m²."""
        return (self.x1 - self.x0) * (self.y1 - self.y0)

    def span(self, axis: int) -> tuple[float, float]:
        """Return its lower and upper coordinate on an axis, 0 = x."""
        return (self.x0, self.x1) if axis == 0 else (self.y0, self.y1)

    def touches(self, other: Area) -> bool:
        """Return True if the two overlap."""
        return self.x0 < other.x1 and other.x0 < self.x1 and self.y0 < other.y1 and other.y0 < self.y1

    def distance_m(self, x: float, y: float) -> float:
        """Return the distance of a point, 0 inside."""
        return math.hypot(max(self.x0 - x, x - self.x1, 0.0), max(self.y0 - y, y - self.y1, 0.0))

    def grown(self, margin_m: float) -> Area:
        """Return the area with a margin on each side."""
        return Area(self.x0 - margin_m, self.y0 - margin_m, self.x1 + margin_m, self.y1 + margin_m)


class FlatBuilder:
    """The rooms of a flat, the footprints of its contents, and their meshes."""

    def __init__(self, rng: Rng, fine: bool, length_m: float, width_m: float, height_m: float) -> None:
        """Begin with one room that fills the shell. fine: with texture."""
        self.rng = rng
        self.builder = MeshBuilder(fine)
        self.length_m = length_m
        self.width_m = width_m
        self.height_m = height_m
        self.parts: list[Mesh] = []
        self.standing: list[Area] = []  # footprints of walls and furniture on the floor
        self.door_areas: list[Area] = []
        self.no_lamps: list[Area] = []  # floor above which no lamp may hang
        self.rooms = [Area(0.0, 0.0, length_m, width_m)]

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

    def add_wall(self, wall: Area, bottom_m: float, axis: int, painted_m: float) -> None:
        """Add a wall from a height up to the ceiling.

        axis, painted_m: along which windows and pictures hang, and how far.
        """
        paint = self._wall_paint(axis, painted_m)
        box = (wall.x0, wall.y0, bottom_m), (wall.x1, wall.y1, self.height_m)
        self.parts.append(self.builder.box(*box, paint, PAINT_STEP_M))
        if bottom_m == 0.0:
            self.standing.append(wall)

    def divide(self, room: Area, across: int, at: float, thick_m: float, left: float, door_m: float, lintel_m: float) -> Area:
        """Divide a room by a wall with a doorway; return the doorway.

        across: axis along which the wall is passed, 0 = x. at: its side of lower coordinate on that axis. left: jamb of lower
        coordinate. lintel_m: height of the doorway.
        """
        (low, high), (side0, side1) = room.span(across), room.span(1 - across)
        for begin, end, bottom in ((side0, left, 0.0), (left + door_m, side1, 0.0), (left, left + door_m, lintel_m)):
            if end - begin > 1e-6 and self.height_m - bottom > 1e-6:
                self.add_wall(Area.across(across, at, at + thick_m, begin, end), bottom, 1 - across, side1)
        self.door_areas.append(Area.across(across, at - DOORSTEP_M, at + thick_m + DOORSTEP_M, left, left + door_m))
        self.rooms.remove(room)
        self.rooms += [Area.across(across, low, at, side0, side1), Area.across(across, at + thick_m, high, side0, side1)]
        return Area.across(across, at, at + thick_m, left, left + door_m)

    # -- furniture ------------------------------------------------------------------------------------------------

    def furnish(self, room: Area, per_m2: tuple[float, float]) -> None:
        """Add furniture at the walls and elsewhere, pillars and lamps.

        per_m2: range of the number of pieces, before those that do not fit.
        """
        rng, w = self.rng, self.builder
        pieces = rng.uniform(*per_m2) * room.square_m
        for _ in range(max(1, round(0.6 * pieces))):
            self._against_a_wall(room, furniture.AT_WALLS[int(rng.integers(len(furniture.AT_WALLS)))](w, rng))
        for _ in range(max(1, round(0.5 * pieces))):
            self._anywhere(room, furniture.ANYWHERE[int(rng.integers(len(furniture.ANYWHERE)))](w, rng))
        if room.square_m > 14.0 and rng.random() < 0.4:
            self._anywhere(room, furniture.pillar(w, rng, self.height_m))
        for _ in range(int(rng.integers(0, 2 + int(room.square_m / 20.0)))):
            lamp = furniture.hanging_lamp(w, rng, self.height_m)
            x, y = rng.uniform(room.x0 + 0.4, room.x1 - 0.4), rng.uniform(room.y0 + 0.4, room.y1 - 0.4)
            place = Area(x, y, x, y).grown(lamp.half_x)
            if not any(place.touches(other) for other in self.no_lamps):
                self.parts.append(lamp.placed(x, y, 0.0))

    def _against_a_wall(self, room: Area, piece: Piece) -> None:
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

    def _anywhere(self, room: Area, piece: Piece) -> None:
        rng = self.rng
        for _ in range(TRIES):
            turn = rng.choice([0.0, 0.5 * math.pi, rng.uniform(-math.pi, math.pi)])
            x, y = rng.uniform(room.x0, room.x1), rng.uniform(room.y0, room.y1)
            if self._place(room, piece, x, y, float(turn), float(rng.choice([0.05, 0.3, 0.8]))):
                return

    def _place(self, room: Area, piece: Piece, x: float, y: float, turn_rad: float, gap_m: float) -> bool:
        """Place a piece if it fits into the room with the gap to other pieces; return True if so."""
        half_x, half_y = piece.reach(turn_rad)
        place = Area(x - half_x, y - half_y, x + half_x, y + half_y)
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
