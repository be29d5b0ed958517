"""Where faults are flown: a hall with room to be fast in, a pen inside it, two small rooms with a tight gap between, and a
gallery to be far from home in.
"""

from __future__ import annotations

import functools

from sitl.faults.passage import Gap
from sitl.mesh import Mesh, joined
from sitl.scene import Scene, place
from sitl.solids import Workshop
from sitl.texture import checks, plain

LENGTH_M, WIDTH_M, HEIGHT_M = 10.0, 7.0, 2.8
START = (1.4, 3.5, 1.2, 0.0)
PEN = (0.4, 1.0, 0.0, 8.4, 6.0, 2.6)
SMALL_M = (5.8, 2.8, 2.4)  # of both rooms: soon looked round in
GALLERY_M = (32.0, 3.5, 2.8)
GAP, GAP_WIDTH_M = Gap(1.2, 2.2), 0.9
_WALLS = checks((0.8, 0.8, 0.75), (0.6, 0.62, 0.65), 0.4)


@functools.cache  # a campaign flies in the same few, again and again
def arena(name: str, radius_m: float) -> Scene:
    """hall, pen, corridor or gallery. The start is the same in all."""
    pieces = {"corridor": _corridor, "gallery": _gallery}.get(name, _hall)()
    return place(name, joined(pieces), START, PEN if name == "pen" else None, radius_m)


def _shell(x: float, y: float, z: float) -> list[Mesh]:
    """Of a length, a width whose middle is the hall's, and a height."""
    w, low, high = Workshop(fine=False), 0.5 * (WIDTH_M - y), 0.5 * (WIDTH_M + y)
    return [
        w.patch((0, low, 0), (x, 0, 0), (0, y, 0), _WALLS),
        w.patch((0, low, z), (0, y, 0), (x, 0, 0), _WALLS),
        w.patch((0, low, 0), (0, 0, z), (x, 0, 0), _WALLS),
        w.patch((0, high, 0), (x, 0, 0), (0, 0, z), _WALLS),
        w.patch((0, low, 0), (0, y, 0), (0, 0, z), _WALLS),
        w.patch((x, low, 0), (0, 0, z), (0, y, 0), _WALLS),
    ]


def _hall() -> list[Mesh]:
    w, grey = Workshop(fine=False), plain((0.5, 0.5, 0.55))
    return [
        *_shell(LENGTH_M, WIDTH_M, HEIGHT_M),
        w.box((4.2, 1.2, 0.0), (4.7, 1.7, HEIGHT_M), grey),
        w.box((6.5, 5.0, 0.0), (7.0, 5.5, HEIGHT_M), grey),
        w.box((7.6, 1.4, 0.0), (9.0, 2.0, 0.8), grey),
    ]


def _gallery() -> list[Mesh]:
    w, grey, (_, middle, *_) = Workshop(fine=False), plain((0.5, 0.5, 0.55)), START
    pillars = [(9.0, 0.9), (16.0, -0.9), (23.0, 0.9)]
    return [
        *_shell(*GALLERY_M),
        *(w.box((x, middle + y - 0.2, 0.0), (x + 0.4, middle + y + 0.2, GALLERY_M[2]), grey) for x, y in pillars),
    ]


def _corridor() -> list[Mesh]:
    w, grey, (_, width_m, height_m) = Workshop(fine=False), plain((0.5, 0.5, 0.55)), SMALL_M
    (pad_m, middle, *_), half_m = START, 0.5 * GAP_WIDTH_M
    begin, end = pad_m + GAP.begin_m, pad_m + GAP.end_m
    return [
        *_shell(*SMALL_M),
        w.box((begin, middle - 0.5 * width_m, 0.0), (end, middle - half_m, height_m), grey),
        w.box((begin, middle + half_m, 0.0), (end, middle + 0.5 * width_m, height_m), grey),
    ]
