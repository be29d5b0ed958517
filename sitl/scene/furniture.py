"""Furniture of generated rooms. Each piece is built at the origin on the floor, back to -y."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sitl.scene import texture
from sitl.scene.mesh import Mesh, joined
from sitl.scene.primitives import MeshBuilder

Rng = np.random.Generator


@dataclass(frozen=True)
class Piece:
    """A piece of furniture: its mesh and the half sizes of its footprint, m."""

    mesh: Mesh
    half_x: float
    half_y: float

    def placed(self, x: float, y: float, turn_rad: float) -> Mesh:
        """Return the mesh rotated counter-clockwise about the origin, then moved to (x, y)."""
        c, s = math.cos(turn_rad), math.sin(turn_rad)
        v = self.mesh.vertices.astype(np.float64)
        turned = np.stack([c * v[:, 0] - s * v[:, 1] + x, s * v[:, 0] + c * v[:, 1] + y, v[:, 2]], axis=1)
        return Mesh(turned.astype(np.float32), self.mesh.faces, self.mesh.rgb)

    def reach(self, turn_rad: float) -> tuple[float, float]:
        """Return the half sizes (m) of the axis-aligned box around the rotated footprint."""
        c, s = abs(math.cos(turn_rad)), abs(math.sin(turn_rad))
        return c * self.half_x + s * self.half_y, s * self.half_x + c * self.half_y


Maker = Callable[[MeshBuilder, Rng], Piece]


def _colour(rng: Rng, low: float = 0.2, high: float = 0.8) -> tuple[float, ...]:
    return tuple(float(c) for c in rng.uniform(low, high, 3))


def _wood(rng: Rng) -> texture.Paint:
    light = rng.uniform(0.35, 0.8)
    return texture.wood((light, light * rng.uniform(0.62, 0.78), light * rng.uniform(0.38, 0.55)))


def _chair(w: MeshBuilder, rng: Rng) -> Piece:
    wood, cloth, seat = _wood(rng), texture.cloth(_colour(rng)), 0.22
    legs = [
        w.box((i * 0.19 - 0.018, j * 0.19 - 0.018, 0.0), (i * 0.19 + 0.018, j * 0.19 + 0.018, 0.44), wood)
        for i in (-1, 1)
        for j in (-1, 1)
    ]
    posts = [w.box((i * 0.19 - 0.018, -0.205, 0.47), (i * 0.19 + 0.018, -0.175, 0.92), wood) for i in (-1, 1)]
    slats = [w.box((-0.17, -0.20, z), (0.17, -0.18, z + 0.08), wood) for z in (0.60, 0.78)]
    top = w.box((-seat + 0.01, -seat + 0.01, 0.44), (seat - 0.01, seat - 0.01, 0.47), cloth)
    return Piece(joined([*legs, *posts, *slats, top]), seat, seat)


def table(w: MeshBuilder, rng: Rng) -> Piece:
    """Return a table: a thin top on four legs, chairs around it, a few objects on it."""
    half_x, half_y, height = rng.uniform(0.5, 0.9), rng.uniform(0.35, 0.45), rng.uniform(0.70, 0.76)
    wood = _wood(rng)
    parts = [w.box((-half_x, -half_y, height - 0.03), (half_x, half_y, height), wood)]
    for i in (-1, 1):
        for j in (-1, 1):
            x, y = i * (half_x - 0.06), j * (half_y - 0.06)
            parts.append(w.box((x - 0.025, y - 0.025, 0.0), (x + 0.025, y + 0.025, height - 0.03), wood))
    out = half_y
    for side in (-1, 1):
        for x in np.linspace(-half_x + 0.3, half_x - 0.3, max(1, int(half_x / 0.4))):
            if rng.random() < 0.6:
                away = half_y + rng.uniform(-0.02, 0.18)
                turn = (0.0 if side < 0 else math.pi) + rng.uniform(-0.3, 0.3)
                parts.append(_chair(w, rng).placed(float(x), side * away, turn))
                out = max(out, away + 0.32)
    for _ in range(rng.integers(0, 3)):
        x, y, r = rng.uniform(-half_x + 0.2, half_x - 0.2), rng.uniform(-half_y + 0.2, half_y - 0.2), rng.uniform(0.04, 0.12)
        parts.append(
            w.tube((x, y, height), r, r * rng.uniform(0.6, 1.4), rng.uniform(0.06, 0.25), texture.cloth(_colour(rng)), True)
        )
    return Piece(joined(parts), half_x, out)


def shelf(w: MeshBuilder, rng: Rng) -> Piece:
    """Return an open shelf with blocks of books and boxes."""
    half_x, half_y, height = rng.uniform(0.4, 0.8), rng.uniform(0.13, 0.2), rng.uniform(1.2, 2.05)
    wood, levels = _wood(rng), np.linspace(0.06, height - 0.03, int(height / 0.38) + 1)
    parts = [w.box((-half_x, -half_y, z), (half_x, half_y, z + 0.025), wood) for z in levels]
    parts += [w.box((x, -half_y, 0.0), (x + 0.025, half_y, height), wood) for x in (-half_x, half_x - 0.025)]
    parts.append(w.box((-half_x, -half_y, 0.0), (half_x, -half_y + 0.01, height), texture.dimmed(wood, 0.6)))
    for z in levels[:-1]:
        x = -half_x + 0.04
        while x < half_x - 0.15:
            wide, tall, deep = rng.uniform(0.08, 0.35), rng.uniform(0.12, 0.30), rng.uniform(0.02, 0.08)
            if rng.random() < 0.75:
                corner = (x, -half_y + 0.015, float(z) + 0.025)
                far = (min(x + wide, half_x - 0.03), half_y - deep, float(z) + 0.025 + tall)
                paint = texture.book(_colour(rng, 0.15, 0.65), corner[2], tall)
                parts.append(w.box(corner, far, paint if rng.random() < 0.7 else texture.carton(_colour(rng), corner)))
            x += wide + 0.01
    return Piece(joined(parts), half_x, half_y)


def cabinet(w: MeshBuilder, rng: Rng) -> Piece:
    """Return a low cupboard, in some cases with a box on top."""
    half_x, half_y, height = rng.uniform(0.4, 0.8), rng.uniform(0.2, 0.3), rng.uniform(0.6, 1.1)
    parts = [w.box((-half_x, -half_y, 0.0), (half_x, half_y, height), texture.cabinet)]
    if rng.random() < 0.6:
        x, size = rng.uniform(-half_x + 0.2, half_x - 0.2), rng.uniform(0.12, 0.18)
        corner = (x - size, -0.12, height)
        parts.append(w.box(corner, (x + size, 0.12, height + 1.4 * size), texture.carton(_colour(rng), corner)))
    return Piece(joined(parts), half_x, half_y)


def sofa(w: MeshBuilder, rng: Rng) -> Piece:
    """Return a sofa of one to three seats."""
    half_x, half_y = rng.choice([0.42, 0.75, 1.0]), 0.42
    cloth = texture.cloth(_colour(rng))
    parts = [
        w.box((-half_x, -half_y, 0.08), (half_x, half_y, 0.42), cloth),
        w.box((-half_x, -half_y, 0.42), (half_x, -half_y + 0.18, rng.uniform(0.75, 0.95)), cloth),
        w.box((-half_x, -half_y + 0.18, 0.42), (-half_x + 0.14, half_y, 0.60), cloth),
        w.box((half_x - 0.14, -half_y + 0.18, 0.42), (half_x, half_y, 0.60), cloth),
    ]
    return Piece(joined(parts), float(half_x), half_y)


def bed(w: MeshBuilder, rng: Rng) -> Piece:
    """Return a bed with its head at the back."""
    half_x, half_y = rng.uniform(0.45, 0.8), 1.02
    sheet = texture.checks(_colour(rng), (0.9, 0.88, 0.84), 0.12)
    parts = [
        w.box((-half_x, -half_y, 0.15), (half_x, half_y, 0.48), sheet),
        w.box((-half_x, -half_y, 0.0), (half_x, -half_y + 0.05, rng.uniform(0.7, 1.1)), _wood(rng)),
        w.box((-half_x + 0.1, -half_y + 0.1, 0.48), (half_x - 0.1, -half_y + 0.45, 0.60), texture.cloth((0.85, 0.85, 0.82))),
    ]
    return Piece(joined(parts), half_x, half_y)


def boxes(w: MeshBuilder, rng: Rng) -> Piece:
    """Return a pile of one to three cartons, each rotated a little."""
    half, z, parts = rng.uniform(0.18, 0.32), 0.0, []
    reach = half * 1.42
    for _ in range(rng.integers(1, 4)):
        tall = rng.uniform(0.6, 1.4) * half
        box = Piece(
            w.box((-half, -0.8 * half, z), (half, 0.8 * half, z + tall), texture.carton(_colour(rng), (-half, -half, z))),
            half,
            half,
        )
        parts.append(box.placed(rng.uniform(-0.03, 0.03), rng.uniform(-0.03, 0.03), rng.uniform(-0.5, 0.5)))
        z, half = z + tall, half * rng.uniform(0.75, 1.0)
    return Piece(joined(parts), reach, reach)


def plant(w: MeshBuilder, rng: Rng) -> Piece:
    """Return a plant: pot, stem and leaves."""
    radius, stem = rng.uniform(0.18, 0.32), rng.uniform(0.2, 0.7)
    pot = texture.checks(_colour(rng), _colour(rng), 0.08)
    parts = [
        w.tube((0.0, 0.0, 0.0), 0.12, 0.17, 0.30, pot, lid=True),
        w.tube((0.0, 0.0, 0.30), 0.02, 0.015, stem, texture.wood((0.35, 0.25, 0.15))),
        w.bush((0.0, 0.0, 0.30 + stem + 0.8 * radius), radius, texture.leaves),
    ]
    return Piece(joined(parts), 1.2 * radius, 1.2 * radius)


def floor_lamp(w: MeshBuilder, rng: Rng) -> Piece:
    """Return a floor lamp: a thin pole with a shade."""
    height, metal = rng.uniform(1.2, 1.6), texture.plain((0.22, 0.22, 0.24))
    parts = [
        w.tube((0.0, 0.0, 0.0), 0.14, 0.14, 0.025, metal, lid=True),
        w.tube((0.0, 0.0, 0.025), 0.014, 0.014, height - 0.025, metal),
        w.tube((0.0, 0.0, height), 0.20, 0.14, 0.28, texture.pleats((0.93, 0.84, 0.62))),
    ]
    return Piece(joined(parts), 0.20, 0.20)


def screen(w: MeshBuilder, rng: Rng) -> Piece:
    """Return a thin partition on two feet."""
    half_x, height = rng.uniform(0.4, 0.9), rng.uniform(1.3, 2.0)
    cloth = texture.checks(_colour(rng), _colour(rng), 0.15)
    feet = [w.box((x - 0.02, -0.18, 0.0), (x + 0.02, 0.18, 0.03), _wood(rng)) for x in (-half_x + 0.1, half_x - 0.1)]
    return Piece(joined([*feet, w.box((-half_x, -0.015, 0.03), (half_x, 0.015, height), cloth)]), half_x, 0.18)


def pillar(w: MeshBuilder, rng: Rng, height_m: float) -> Piece:
    """Return a round or square pillar from floor to ceiling."""
    half = rng.uniform(0.10, 0.22)
    paint = texture.tiles(_colour(rng, 0.4, 0.8), 0.25)
    if rng.random() < 0.5:
        return Piece(w.tube((0.0, 0.0, 0.0), half, half, height_m, paint), half, half)
    return Piece(w.box((-half, -half, 0.0), (half, half, height_m), paint), half, half)


def hanging_lamp(w: MeshBuilder, rng: Rng, height_m: float) -> Piece:
    """Return a lamp shade on a cord, its lower rim at least 1.5 m above the floor."""
    shade, drop = rng.uniform(0.18, 0.28), rng.uniform(0.35, min(1.1, height_m - 1.5))
    low, radius = height_m - drop, rng.uniform(0.12, 0.24)
    parts = [
        w.tube((0.0, 0.0, low + shade), 0.008, 0.008, drop - shade, texture.plain((0.22, 0.22, 0.24))),
        w.tube((0.0, 0.0, low), radius, 0.4 * radius, shade, texture.pleats(_colour(rng, 0.3, 0.9))),
    ]
    return Piece(joined(parts), radius, radius)


def board(w: MeshBuilder, rng: Rng) -> Piece:
    """Return a thin wall board at head height with boxes on it and free space below."""
    half_x, half_y, height = rng.uniform(0.3, 0.7), rng.uniform(0.1, 0.15), rng.uniform(1.2, 1.6)
    parts, x = [w.box((-half_x, -half_y, height), (half_x, half_y, height + 0.03), _wood(rng))], -half_x + 0.05
    while x < half_x - 0.2:
        size, corner = rng.uniform(0.12, 0.2), (x, -half_y + 0.02, height + 0.03)
        far = (x + size, half_y - 0.02, height + 0.03 + size)
        parts.append(w.box(corner, far, texture.carton(_colour(rng), corner)))
        x += size + rng.uniform(0.05, 0.4)
    return Piece(joined(parts), half_x, half_y)


AT_WALLS: tuple[Maker, ...] = (shelf, cabinet, sofa, bed, shelf, cabinet, board)
ANYWHERE: tuple[Maker, ...] = (table, boxes, plant, floor_lamp, screen, table, sofa, boxes)
