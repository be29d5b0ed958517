"""Scenes for fault flights.

A hall with space to fly fast, a pen inside it, a stage at its far end, two small rooms with a narrow gap between them, a
gallery for long distances from home, and the built-in room of the simulator.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from sitl.faults.judges.gap_passage import Gap
from sitl.scene.mesh import Mesh, joined
from sitl.scene.primitives import MeshBuilder
from sitl.scene.scene import Scene, load_scene, scene_from_mesh
from sitl.scene.texture import plain, wood

LENGTH_M = 10.0
WIDTH_M = 7.0
HEIGHT_M = 2.8
START = (1.4, 3.5, 1.2, 0.0)
PEN = (0.4, 1.0, 0.0, 8.4, 6.0, 2.6)
SMALL_M = (5.8, 2.8, 2.4)  # of both rooms together; explored quickly
GALLERY_M = (32.0, 3.5, 2.8)
STAGE_M = (2.9, 0.6)  # x at which it begins, and its height
GAP = Gap(1.2, 2.2)
GAP_WIDTH_M = 0.9
_WALLS = plain((0.80, 0.80, 0.75))
_FLOOR = wood((0.55, 0.42, 0.30))
_GREY = plain((0.50, 0.50, 0.55))


@functools.cache  # a campaign uses the same few scenes repeatedly
def arena(name: str, radius_m: float, painted: bool = False) -> Scene:
    """Return the scene with this name: hall, pen, stage, corridor, gallery or room.

    The start is the same in all but the room, which is furnished and the only one with texture for visual tracking on every
    surface. The pen contains no obstacles, because the vehicle is pushed out of it. painted: with texture for a camera that
    renders colour; it takes a second.
    """
    if name == "room":
        return load_scene(None, radius_m=radius_m, fine=painted)
    pieces = {"hall": _hall, "pen": _yard, "stage": _stage, "corridor": _corridor, "gallery": _gallery}[name]
    scene = scene_from_mesh(name, joined(pieces(MeshBuilder(fine=False))), START, PEN if name == "pen" else None, radius_m)
    if not painted:
        return scene
    fine = joined(pieces(MeshBuilder()))
    vertices = np.ascontiguousarray(fine.vertices - scene.scene_from_world_m, np.float32)
    return replace(scene, paint=replace(fine, vertices=vertices))


def _shell(w: MeshBuilder, x: float, y: float, z: float) -> list[Mesh]:
    """Return floor, ceiling and walls of a room.

    x: length, y: width, centred on the hall's centre line, z: height (m).
    """
    low, high = 0.5 * (WIDTH_M - y), 0.5 * (WIDTH_M + y)
    return [
        w.patch((0, low, 0), (x, 0, 0), (0, y, 0), _FLOOR),
        w.patch((0, low, z), (0, y, 0), (x, 0, 0), _WALLS),
        w.patch((0, low, 0), (0, 0, z), (x, 0, 0), _WALLS),
        w.patch((0, high, 0), (x, 0, 0), (0, 0, z), _WALLS),
        w.patch((0, low, 0), (0, y, 0), (0, 0, z), _WALLS),
        w.patch((x, low, 0), (0, 0, z), (0, y, 0), _WALLS),
    ]


def _yard(w: MeshBuilder) -> list[Mesh]:
    return _shell(w, LENGTH_M, WIDTH_M, HEIGHT_M)


def _hall(w: MeshBuilder) -> list[Mesh]:
    return [
        *_yard(w),
        w.box((4.2, 1.2, 0.0), (4.7, 1.7, HEIGHT_M), _GREY),
        w.box((6.5, 5.0, 0.0), (7.0, 5.5, HEIGHT_M), _GREY),
        w.box((7.6, 1.4, 0.0), (9.0, 2.0, 0.8), _GREY),
    ]


def _stage(w: MeshBuilder) -> list[Mesh]:
    (begin, z), wide = STAGE_M, (0, WIDTH_M, 0)
    return [
        *_yard(w),
        w.patch((begin, 0, z), (LENGTH_M - begin, 0, 0), wide, _GREY),
        w.patch((begin, 0, 0), (0, 0, z), wide, _GREY),
    ]


def _gallery(w: MeshBuilder) -> list[Mesh]:
    _, middle, *_ = START
    pillars = [(9.0, 0.9), (16.0, -0.9), (23.0, 0.9)]
    return [
        *_shell(w, *GALLERY_M),
        *(w.box((x, middle + y - 0.2, 0.0), (x + 0.4, middle + y + 0.2, GALLERY_M[2]), _GREY) for x, y in pillars),
    ]


def _corridor(w: MeshBuilder) -> list[Mesh]:
    _, width_m, height_m = SMALL_M
    (pad_m, middle, *_), half_m = START, 0.5 * GAP_WIDTH_M
    begin, end = pad_m + GAP.begin_m, pad_m + GAP.end_m
    return [
        *_shell(w, *SMALL_M),
        w.box((begin, middle - 0.5 * width_m, 0.0), (end, middle - half_m, height_m), _GREY),
        w.box((begin, middle + half_m, 0.0), (end, middle + 0.5 * width_m, height_m), _GREY),
    ]
