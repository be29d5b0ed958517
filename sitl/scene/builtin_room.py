"""The built-in room: 8 x 3 x 2.5 m, furnished, textured, and identical on every machine.

Length is along x, width along y, height along z; the origin is a corner of the floor. A vehicle that keeps its centre
0.40 m from every surface can fly from end to end.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from sitl.runtime.array_cache import cache_folder, cached, key
from sitl.scene import mesh, primitives, texture
from sitl.scene.mesh import Mesh, joined
from sitl.scene.primitives import MeshBuilder

LENGTH_M = 8.0
WIDTH_M = 3.0
HEIGHT_M = 2.5
ROOM_START: tuple[float, ...] = (0.9, 1.5, 1.2, 0.0)  # x, y, z (m), yaw (degrees)
FINE_M = 0.024
_SOURCES = (mesh, primitives, texture)
_DIMENSIONS = {"vertices": 2, "faces": 2, "rgb": 2}


def built_in_room(fine: bool = True) -> Mesh:
    """Return the room's mesh in its own frame.

    fine: with texture (about 300k vertices, under a second); otherwise grey (10k vertices).
    """
    if not fine:
        return _made(fine)
    sources = key(*(Path(str(module.__file__)).read_text(encoding="utf-8") for module in (sys.modules[__name__], *_SOURCES)))
    arrays = cached(cache_folder() / f"built-in-room-{sources}.npz", _DIMENSIONS, lambda: vars(_made(fine)))
    return Mesh(**arrays)


def _made(fine: bool) -> Mesh:
    w = MeshBuilder(fine)
    pieces = (_shell, _sofa, _shelf, _table, _sideboard, _armchair, _lamps, _radiators, _start_corner)
    return joined([part for piece in pieces for part in piece(w)])


def _shell(w: MeshBuilder) -> list[Mesh]:
    x, y, z = LENGTH_M, WIDTH_M, HEIGHT_M
    return [
        w.patch((0, 0, 0), (x, 0, 0), (0, y, 0), texture.floor, FINE_M),
        w.patch((0, 0, z), (0, y, 0), (x, 0, 0), texture.ceiling, 0.035),
        w.patch((0, 0, 0), (0, 0, z), (x, 0, 0), texture.south_wall, FINE_M),
        w.patch((0, y, 0), (x, 0, 0), (0, 0, z), texture.north_wall, FINE_M),
        w.patch((0, 0, 0), (0, y, 0), (0, 0, z), texture.west_wall, FINE_M),
        w.patch((x, 0, 0), (0, 0, z), (0, y, 0), texture.east_wall, FINE_M),
        w.box((3.0, 0.95, 0.0), (4.8, 2.25, 0.012), texture.rug, 0.02),
    ]


def _sofa(w: MeshBuilder) -> list[Mesh]:
    cloth, cushion = texture.cloth((0.25, 0.36, 0.42)), texture.cloth((0.80, 0.55, 0.20))
    seats = [w.box((2.2 + 0.55 * i, 0.22, 0.25), (2.74 + 0.55 * i, 0.88, 0.44), cloth) for i in range(3)]
    return [
        w.box((2.05, 0.03, 0.08), (4.00, 0.88, 0.25), cloth),
        w.box((2.05, 0.03, 0.25), (4.00, 0.22, 0.84), cloth),
        w.box((2.05, 0.03, 0.25), (2.20, 0.88, 0.60), cloth),
        w.box((3.85, 0.03, 0.25), (4.00, 0.88, 0.60), cloth),
        *seats,
        w.box((2.24, 0.24, 0.44), (2.62, 0.38, 0.78), cushion, 0.02),
        w.box((3.42, 0.24, 0.44), (3.80, 0.36, 0.80), texture.checks((0.65, 0.2, 0.2), (0.9, 0.85, 0.75), 0.07), 0.02),
    ]


def _shelf(w: MeshBuilder) -> list[Mesh]:
    """Return an open bookshelf on the north wall, x 2.2 to 3.6, with books and boxes."""
    wood, low, high, back, front = texture.wood((0.55, 0.38, 0.22)), 2.2, 3.6, 2.98, 2.68
    boards = [w.box((low, front, z), (high, back, z + 0.025), wood) for z in (0.05, 0.43, 0.81, 1.19, 1.57, 1.93)]
    sides = [w.box((x, front, 0.0), (x + 0.025, back, 1.955), wood) for x in (low, 2.8875, high - 0.025)]
    panel = w.patch((low, back, 0.0), (high - low, 0, 0), (0, 0, 1.95), texture.dimmed(wood, 0.6))
    rng = np.random.default_rng(7)
    things: list[Mesh] = []
    for level in (0.075, 0.455, 0.835, 1.215, 1.595):
        for begin, end in ((low + 0.03, 2.88), (2.92, high - 0.03)):
            if rng.random() < 0.25:
                colour = tuple(rng.uniform(0.3, 0.8, 3))
                box = ((begin + 0.06, front + 0.02, level), (end - 0.08, back - 0.05, level + 0.24))
                things.append(w.box(*box, texture.carton(colour, box[0])))
                continue
            x = begin
            while x < end - 0.06:
                thick, tall, deep = rng.uniform(0.025, 0.055), rng.uniform(0.19, 0.32), rng.uniform(0.02, 0.07)
                book = ((x, front + deep, level), (min(x + thick, end), back - 0.06, level + tall))
                things.append(w.box(*book, texture.book(tuple(rng.uniform(0.15, 0.65, 3)), level, tall), 0.024))
                x += thick + (0.12 if rng.random() < 0.08 else 0.001)
    return [*boards, *sides, panel, *things]


def chair(w: MeshBuilder, x: float, y: float, side: float) -> list[Mesh]:
    """Return a chair with its seat centred at (x, y), its back towards side (+1: +y, -1: -y)."""
    wood = texture.wood((0.42, 0.26, 0.15))
    legs = [
        w.box((x + i * 0.19 - 0.018, y + j * 0.19 - 0.018, 0.0), (x + i * 0.19 + 0.018, y + j * 0.19 + 0.018, 0.44), wood)
        for i in (-1, 1)
        for j in (-1, 1)
    ]
    back_y = y + side * 0.19
    posts = [
        w.box((x + i * 0.19 - 0.018, back_y - 0.015, 0.47), (x + i * 0.19 + 0.018, back_y + 0.015, 0.92), wood) for i in (-1, 1)
    ]
    slats = [w.box((x - 0.17, back_y - 0.01, z), (x + 0.17, back_y + 0.01, z + 0.08), wood) for z in (0.60, 0.78)]
    seat = w.box((x - 0.21, y - 0.21, 0.44), (x + 0.21, y + 0.21, 0.47), texture.cloth((0.55, 0.18, 0.16)))
    return [*legs, *posts, *slats, seat]


def _table(w: MeshBuilder) -> list[Mesh]:
    """Return a dining table on the north side with a thin top, two chairs and objects on it."""
    wood = texture.wood((0.68, 0.50, 0.32))
    legs = [w.box((x, y, 0.0), (x + 0.05, y + 0.05, 0.72), wood) for x in (5.04, 6.41) for y in (2.19, 2.86)]
    bowl = texture.checks((0.15, 0.3, 0.6), (0.92, 0.92, 0.9), 0.05)
    return [
        w.box((5.0, 2.15, 0.72), (6.5, 2.95, 0.75), wood, 0.024),
        *legs,
        *chair(w, 5.40, 2.02, -1.0),
        *chair(w, 6.10, 2.02, -1.0),
        w.tube((5.35, 2.6, 0.75), 0.06, 0.13, 0.09, bowl),
        w.tube((6.15, 2.7, 0.75), 0.045, 0.03, 0.24, texture.cloth((0.1, 0.45, 0.4)), lid=True),
        w.box((5.70, 2.45, 0.75), (5.95, 2.65, 0.79), texture.checks((0.8, 0.3, 0.2), (0.95, 0.9, 0.8), 0.05), 0.02),
    ]


def _sideboard(w: MeshBuilder) -> list[Mesh]:
    """Return a cabinet on the south wall, x 5.2 to 6.8, with boxes and a plant on top."""
    return [
        w.box((5.2, 0.02, 0.10), (6.8, 0.42, 0.82), texture.cabinet, 0.024),
        w.box((5.25, 0.06, 0.0), (6.75, 0.38, 0.10), texture.plain((0.12, 0.11, 0.10))),
        w.box((5.35, 0.08, 0.82), (5.70, 0.34, 1.04), texture.carton((0.72, 0.55, 0.36), (5.35, 0.08, 0.82))),
        w.box((5.78, 0.10, 0.82), (6.02, 0.32, 0.95), texture.carton((0.30, 0.45, 0.62), (5.78, 0.10, 0.82))),
        w.tube((6.45, 0.22, 0.82), 0.07, 0.10, 0.16, texture.cloth((0.70, 0.35, 0.22)), lid=True),
        w.bush((6.45, 0.24, 1.14), 0.16, texture.leaves),
    ]


def _armchair(w: MeshBuilder) -> list[Mesh]:
    cloth = texture.cloth((0.46, 0.22, 0.26))
    return [
        w.box((7.10, 0.06, 0.10), (7.92, 0.80, 0.42), cloth),
        w.box((7.74, 0.06, 0.42), (7.92, 0.80, 0.88), cloth),
        w.box((7.10, 0.06, 0.42), (7.74, 0.18, 0.62), cloth),
        w.box((7.10, 0.68, 0.42), (7.74, 0.80, 0.62), cloth),
        w.tube((7.55, 2.62, 0.0), 0.13, 0.18, 0.32, texture.checks((0.75, 0.72, 0.66), (0.45, 0.40, 0.36), 0.08), lid=True),
        w.tube((7.55, 2.62, 0.32), 0.02, 0.015, 0.45, texture.wood((0.35, 0.25, 0.15))),
        w.bush((7.55, 2.62, 0.98), 0.28, texture.leaves),
    ]


def _lamps(w: MeshBuilder) -> list[Mesh]:
    metal, shade = texture.plain((0.22, 0.22, 0.24)), texture.pleats((0.93, 0.84, 0.62))
    return [
        w.tube((1.75, 0.28, 0.0), 0.14, 0.14, 0.025, metal, lid=True),
        w.tube((1.75, 0.28, 0.025), 0.014, 0.014, 1.40, metal),
        w.tube((1.75, 0.28, 1.40), 0.20, 0.14, 0.28, shade),
        w.tube((5.75, 2.55, 1.92), 0.008, 0.008, 0.58, metal),
        w.tube((5.75, 2.55, 1.68), 0.21, 0.07, 0.24, texture.pleats((0.75, 0.25, 0.18))),
    ]


def _radiators(w: MeshBuilder) -> list[Mesh]:
    """Return the ribbed radiators below the east window and beside the shelf on the north wall."""
    paint = texture.plain((0.90, 0.89, 0.85))
    east = [w.box((7.86, 1.00 + 0.08 * i, 0.12), (7.96, 1.055 + 0.08 * i, 0.68), paint) for i in range(13)]
    north = [w.box((3.95 + 0.08 * i, 2.87, 0.12), (4.005 + 0.08 * i, 2.97, 0.68), paint) for i in range(10)]
    bars = [
        w.box((7.89, 1.00, 0.60), (7.93, 2.02, 0.64), paint),
        w.box((3.95, 2.90, 0.60), (4.73, 2.94, 0.64), paint),
        w.box((7.78, 0.95, 0.80), (8.00, 2.10, 0.83), texture.wood((0.80, 0.76, 0.70))),
    ]
    return [*east, *north, *bars]


def _start_corner(w: MeshBuilder) -> list[Mesh]:
    """Return a board with boxes (north wall) and a low chest (south wall), near the start."""
    return [
        w.box((0.25, 2.76, 1.45), (1.45, 2.99, 1.48), texture.wood((0.60, 0.42, 0.25))),
        w.box((0.35, 2.80, 1.48), (0.62, 2.97, 1.70), texture.carton((0.75, 0.62, 0.30), (0.35, 2.80, 1.48))),
        w.box((0.95, 2.80, 1.48), (1.15, 2.97, 1.64), texture.carton((0.40, 0.62, 0.45), (0.95, 2.80, 1.48))),
        w.box((0.15, 0.04, 0.0), (1.15, 0.50, 0.46), texture.cabinet, 0.024),
        w.box((0.30, 0.10, 0.46), (0.62, 0.40, 0.66), texture.carton((0.55, 0.40, 0.62), (0.30, 0.10, 0.46))),
    ]
