"""Where faults are flown: a hall with room to be fast in, a pen inside it, and two rooms with a tight gap between."""

from __future__ import annotations

from sitl.mesh import Mesh, joined
from sitl.scene import Scene, place
from sitl.solids import Workshop
from sitl.texture import checks, plain

LENGTH_M, WIDTH_M, HEIGHT_M = 10.0, 7.0, 2.8
START = (1.4, 3.5, 1.2, 0.0)
PEN = (0.4, 1.0, 0.0, 8.4, 6.0, 2.6)
GAP_M = 0.9
_WALLS = checks((0.8, 0.8, 0.75), (0.6, 0.62, 0.65), 0.4)


def arena(name: str, radius_m: float) -> Scene:
    """hall, pen or corridor. The start is the same in all."""
    pieces = _corridor() if name == "corridor" else _hall()
    return place(name, joined(pieces), START, PEN if name == "pen" else None, radius_m)


def _shell() -> list[Mesh]:
    w, (x, y, z) = Workshop(fine=False), (LENGTH_M, WIDTH_M, HEIGHT_M)
    return [
        w.patch((0, 0, 0), (x, 0, 0), (0, y, 0), _WALLS),
        w.patch((0, 0, z), (0, y, 0), (x, 0, 0), _WALLS),
        w.patch((0, 0, 0), (0, 0, z), (x, 0, 0), _WALLS),
        w.patch((0, y, 0), (x, 0, 0), (0, 0, z), _WALLS),
        w.patch((0, 0, 0), (0, y, 0), (0, 0, z), _WALLS),
        w.patch((x, 0, 0), (0, 0, z), (0, y, 0), _WALLS),
    ]


def _hall() -> list[Mesh]:
    w, grey = Workshop(fine=False), plain((0.5, 0.5, 0.55))
    return [
        *_shell(),
        w.box((4.2, 1.2, 0.0), (4.7, 1.7, HEIGHT_M), grey),
        w.box((6.5, 5.0, 0.0), (7.0, 5.5, HEIGHT_M), grey),
        w.box((7.6, 1.4, 0.0), (9.0, 2.0, 0.8), grey),
    ]


def _corridor() -> list[Mesh]:
    w, grey, middle = Workshop(fine=False), plain((0.5, 0.5, 0.55)), 0.5 * WIDTH_M
    low, high = middle - 0.5 * GAP_M, middle + 0.5 * GAP_M
    return [
        *_shell(),
        w.box((4.8, 0.0, 0.0), (6.0, low, HEIGHT_M), grey),
        w.box((4.8, high, 0.0), (6.0, WIDTH_M, HEIGHT_M), grey),
    ]
