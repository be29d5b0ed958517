"""Procedural textures: deterministic functions from points (N, 3), m, to colours (N, 3)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

F64 = NDArray[np.float64]
Paint = Callable[[F64], F64]
Colour = tuple[float, ...]


def to_rgb(colour: F64) -> NDArray[np.uint8]:
    """Convert colours (N, 3) in 0..1 to bytes."""
    return np.asarray(np.rint(np.clip(colour, 0.0, 1.0) * 255.0), np.uint8)


def noise(points: F64, cell_m: float, seed: int = 0) -> F64:
    """Return smooth value noise (N,) in 0..1 with features of the size cell_m.

    Hashed lattice values are interpolated trilinearly with smoothstep weights.
    """
    scaled = points / cell_m
    base = np.floor(scaled).astype(np.int64)
    weight = scaled - base
    weight = weight * weight * (3.0 - 2.0 * weight)
    out = np.zeros(len(points))
    for corner in range(8):
        bits = np.array([corner & 1, corner >> 1 & 1, corner >> 2 & 1])
        share = np.where(bits, weight, 1.0 - weight).prod(axis=1)
        out += share * _hash(base + bits, seed)
    return out


def grain(points: F64, cell_m: float, seed: int = 0) -> F64:
    """Return noise (N,) in 0..1 of three octaves down to a quarter of cell_m."""
    return (
        noise(points, cell_m, seed) + 0.5 * noise(points, cell_m / 2, seed + 1) + 0.25 * noise(points, cell_m / 4, seed + 2)
    ) / 1.75


def _hash(cells: NDArray[np.int64], seed: int) -> F64:
    """Return a number in 0..1 for each lattice cell (N, 3), by multiply-xor mixing."""
    primes = np.array([73856093, 19349663, 83492791], np.uint64)
    key = (cells.astype(np.uint64) * primes).sum(axis=1, dtype=np.uint64) + np.uint64(seed * 2654435761)
    for _ in range(2):
        key ^= key >> np.uint64(29)
        key *= np.uint64(0xBF58476D1CE4E5B9)
    key ^= key >> np.uint64(32)
    return np.asarray((key >> np.uint64(11)).astype(np.float64) / 2.0**53)


def _mix(amount: F64, low: ArrayLike, high: ArrayLike) -> F64:
    return np.asarray(np.asarray(low) + amount[:, None] * (np.asarray(high) - np.asarray(low)))


def _shades(base: Colour, points: F64, strength: float, cell_m: float, seed: int = 0) -> F64:
    return np.asarray(base) * (1.0 + strength * (2.0 * grain(points, cell_m, seed) - 1.0))[:, None]


def dimmed(paint: Paint, factor: float) -> Paint:
    """Return a paint with its colours multiplied by a factor."""
    return lambda points: factor * paint(points)


def plain(base: Colour) -> Paint:
    """Return one colour with slight noise."""
    return lambda points: _shades(base, points, 0.08, 0.12)


def cloth(base: Colour) -> Paint:
    """Return woven fabric: blotches and a fine weave."""

    def paint(points: F64) -> F64:
        weave = np.sin(points[:, 0] * 90.0) * np.sin(points[:, 1] * 90.0 + points[:, 2] * 90.0)
        return _shades(base, points, 0.35, 0.10, 3) * (1.0 + 0.12 * weave)[:, None]

    return paint


def wood(base: Colour) -> Paint:
    """Return wood with its grain along x."""

    def paint(points: F64) -> F64:
        stretched = points * np.array([0.18, 1.0, 1.0])
        rings = np.sin(60.0 * (points[:, 1] + points[:, 2]) + 9.0 * noise(stretched, 0.08, 5))
        return _shades(base, stretched, 0.30, 0.05, 4) * (1.0 + 0.13 * rings)[:, None]

    return paint


def checks(first: Colour, second: Colour, size_m: float) -> Paint:
    """Return a chequered pattern along all three axes."""

    def paint(points: F64) -> F64:
        odd = np.floor((points + 1e-4) / size_m).astype(np.int64).sum(axis=1) % 2
        return _mix(odd.astype(np.float64), first, second) * (0.9 + 0.2 * grain(points, 0.06, 8))[:, None]

    return paint


def pleats(base: Colour) -> Paint:
    """Return the folds of a lampshade."""
    return lambda points: np.asarray(base) * (0.88 + 0.16 * np.sin(140.0 * points[:, 0] + 60.0 * points[:, 1]))[:, None]


def leaves(points: F64) -> F64:
    """Return light and dark green spots."""
    return _mix(grain(points, 0.06, 11) ** 1.5, (0.05, 0.16, 0.04), (0.50, 0.85, 0.30))


def book(base: Colour, level_m: float, tall_m: float) -> Paint:
    """Return a book spine with two bands."""

    def paint(points: F64) -> F64:
        height = (points[:, 2] - level_m) / tall_m
        band = ((height > 0.12) & (height < 0.22)) | ((height > 0.68) & (height < 0.86))
        return np.where(band[:, None], 1.0 - 0.6 * np.asarray(base), _shades(base, points, 0.15, 0.05, 12))

    return paint


def carton(base: Colour, corner: tuple[float, float, float]) -> Paint:
    """Return cardboard with a strip of tape and a label."""

    def paint(points: F64) -> F64:
        local = points - np.asarray(corner)
        colour = _shades(base, points, 0.18, 0.06, 13)
        tape = np.abs(local[:, 0] - 0.12) < 0.03
        label = (local[:, 0] > 0.02) & (local[:, 0] < 0.10) & (local[:, 2] > 0.05) & (local[:, 2] < 0.12)
        colour[tape] = np.asarray(base) * 0.6
        colour[label] = (0.95, 0.95, 0.92)
        return colour

    return paint


def cabinet(points: F64) -> F64:
    """Return cabinet doors 0.4 m wide with gaps and round handles."""
    along, height = np.mod(points[:, 0] - 0.2, 0.4), points[:, 2]
    colour = wood((0.80, 0.77, 0.68))(points)
    colour[(along < 0.014) | (along > 0.386)] *= 0.35
    colour[np.hypot(along - 0.33, height - 0.40) < 0.03] = (0.15, 0.13, 0.10)
    return colour


def floor(points: F64) -> F64:
    """Return planks 0.14 m wide and 1.1 m long, each in a different tone."""
    row = np.floor(points[:, 1] / 0.14)
    shifted = points[:, 0] + 0.37 * np.mod(row * 3.0, 7.0)
    board = np.floor(shifted / 1.1)
    tone = _hash(np.stack([board, row, 0.0 * row], axis=1).astype(np.int64), 21)
    stretched = points * np.array([0.15, 1.0, 1.0]) + tone[:, None] * 3.0
    colour = _mix(tone, (0.46, 0.30, 0.17), (0.66, 0.46, 0.28)) * (0.72 + 0.56 * grain(stretched, 0.06, 22))[:, None]
    joint = (np.mod(points[:, 1], 0.14) < 0.012) | (np.mod(shifted, 1.1) < 0.014)
    colour[joint] *= 0.5
    return colour


def rug(points: F64) -> F64:
    """Return a rug of concentric frames around diamonds."""
    x, y = (points[:, 0] - 3.9) / 0.9, (points[:, 1] - 1.6) / 0.65
    edge = np.maximum(np.abs(x), np.abs(y))
    diamonds = np.mod(np.floor(8.0 * (np.abs(x) + np.abs(y))), 3.0)
    palette = np.array([(0.55, 0.12, 0.14), (0.86, 0.78, 0.60), (0.14, 0.20, 0.38)])
    colour = palette[diamonds.astype(np.int64)]
    colour = np.where((edge > 0.78)[:, None], palette[2], colour)
    colour = np.where(((edge > 0.84) & (edge < 0.92))[:, None], palette[1], colour)
    return np.asarray(colour * (0.8 + 0.4 * grain(points, 0.05, 23))[:, None])


def ceiling(points: F64) -> F64:
    """Return ceiling panels 0.6 m wide with dark specks, and three lights."""
    colour = _shades((0.88, 0.88, 0.86), points, 0.10, 0.30, 31)
    speck = noise(points, 0.07, 32)
    colour[speck > 0.80] *= 0.72
    colour[(np.mod(points[:, 0], 0.6) < 0.03) | (np.mod(points[:, 1], 0.6) < 0.03)] *= 0.62
    light = (np.abs(np.mod(points[:, 0], 2.7) - 1.35) < 0.3) & (np.abs(points[:, 1] - 1.5) < 0.15)
    colour[light] = (1.0, 0.99, 0.94)
    return colour


def _wallpaper(points: F64, along: F64, base: Colour) -> F64:
    """Return stripes of uneven width above a panel with a rail, and a skirting board."""
    height = points[:, 2]
    stripe = 0.5 + 0.5 * np.sin(2.0 * np.pi * along / 0.24 + 0.9 * np.sin(2.0 * np.pi * along / 1.7))
    colour = _mix(np.round(stripe * 3.0) / 3.0, np.asarray(base) * 0.80, np.asarray(base) * 1.08)
    colour *= (0.84 + 0.32 * grain(points, 0.16, 41))[:, None]
    dot = np.hypot(np.mod(along, 0.24) - 0.12, np.mod(height, 0.24) - 0.12) < 0.035
    colour[dot] *= np.array([0.70, 0.55, 0.62])
    lower = height < 0.9
    colour[lower] = (wood((0.62, 0.55, 0.44))(points) * (1.0 - 0.25 * (np.mod(along, 0.35) < 0.03))[:, None])[lower]
    colour[np.abs(height - 0.9) < 0.03] = (0.36, 0.28, 0.20)
    colour[height < 0.09] = (0.30, 0.24, 0.18)
    return colour


def _picture(colour: F64, across: F64, height: F64, box: tuple[float, float, float, float], style: int) -> None:
    """Paint a framed abstract picture into colour (N, 3), in place.

    box: lowest across, lowest height, highest across, highest height, m. style: seed of the picture.
    """
    left, bottom, right, top = box
    inside = (across > left) & (across < right) & (height > bottom) & (height < top)
    u, v = (across[inside] - left) / (right - left), (height[inside] - bottom) / (top - bottom)
    rng = np.random.default_rng(style)
    art = np.tile(rng.uniform(0.7, 0.9, 3), (len(u), 1)) * (0.7 + 0.3 * v)[:, None]
    for _ in range(9):
        x, y, size, tone = rng.random(), rng.random(), rng.uniform(0.08, 0.30), rng.uniform(0.15, 0.75, 3)
        shape = np.hypot(u - x, v - y) < size if rng.random() < 0.5 else (np.abs(u - x) < size) & (np.abs(v - y) < 0.6 * size)
        art[shape] = tone
    frame = (u < 0.05) | (u > 0.95) | (v < 0.05) | (v > 0.95)
    art[frame] = (0.16, 0.12, 0.09)
    colour[inside] = art


def south_wall(points: F64) -> F64:
    """Return the wall y = 0, with pictures above the sofa and the sideboard."""
    along, height = points[:, 0], points[:, 2]
    colour = _wallpaper(points, along, (0.72, 0.76, 0.66))
    for style, box in enumerate(
        [(0.3, 1.2, 1.0, 2.0), (2.3, 1.1, 3.0, 1.9), (3.15, 1.25, 3.75, 1.85), (4.3, 1.1, 4.9, 2.0)], 51
    ):
        _picture(colour, along, height, box, style)
    _picture(colour, along, height, (5.5, 1.3, 6.9, 2.1), 56)
    return colour


def north_wall(points: F64) -> F64:
    """Return the wall y = 3, with pictures between board, shelf and table."""
    along, height = points[:, 0], points[:, 2]
    colour = _wallpaper(points, along, (0.70, 0.72, 0.80))
    for style, box in enumerate([(1.6, 1.2, 2.1, 1.9), (3.8, 1.1, 4.7, 2.1), (4.95, 1.2, 5.45, 1.8), (6.2, 1.1, 7.2, 1.9)], 61):
        _picture(colour, along, height, box, style)
    return colour


def west_wall(points: F64) -> F64:
    """Return the wall x = 0, with a panelled door and a notice board."""
    across, height = points[:, 1], points[:, 2]
    colour = _wallpaper(points, across, (0.78, 0.68, 0.58))
    door = (across > 1.05) & (across < 1.95) & (height < 2.05)
    colour[door] = wood((0.52, 0.33, 0.20))(points[:, [2, 1, 0]])[door]
    u, v = np.abs(np.mod(across - 1.05, 0.45) - 0.225), np.abs(np.mod(height, 0.66) - 0.33)
    groove = door & (((u < 0.17) & (u > 0.14) & (v < 0.27)) | ((v < 0.27) & (v > 0.24) & (u < 0.17)))
    colour[groove] *= 0.5
    colour[door & (np.hypot(across - 1.85, height - 1.02) < 0.04)] = (0.85, 0.75, 0.35)
    colour[(np.abs(np.abs(across - 1.5) - 0.48) < 0.035) & (height < 2.08)] = (0.85, 0.82, 0.75)
    _picture(colour, across, height, (2.2, 1.0, 2.8, 1.8), 71)
    return colour


def east_wall(points: F64) -> F64:
    """Return the wall x = 8, with a window whose slats are half down."""
    across, height = points[:, 1], points[:, 2]
    colour = _wallpaper(points, across, (0.78, 0.70, 0.60))
    _window(colour, points, across, height, (0.95, 0.95, 2.10, 2.15))
    _picture(colour, across, height, (0.2, 1.2, 0.7, 1.9), 73)
    return colour


def _window(colour: F64, points: F64, across: F64, height: F64, box: tuple[float, float, float, float]) -> None:
    """Paint a closed window with half-lowered slats into colour (N, 3), in place.

    box: as for _picture().
    """
    left, bottom, right, top = box
    window = (across > left) & (across < right) & (height > bottom) & (height < top)
    sky = _mix(np.clip((height - bottom) / (top - bottom), 0, 1), (0.80, 0.86, 0.90), (0.35, 0.58, 0.88))
    hills = height < bottom + 0.27 + 0.10 * np.sin(5.0 * across) + 0.06 * np.sin(13.0 * across)
    sky[hills] = _mix(grain(points, 0.10, 72), (0.16, 0.30, 0.14), (0.42, 0.58, 0.28))[hills]
    slats = (height > bottom + 0.65) & (np.mod(height, 0.08) < 0.045)
    sky[slats] = (0.93, 0.91, 0.84)
    colour[window] = sky[window]
    middle = 0.5 * (left + right)
    bars = window & ((np.abs(across - middle) < 0.03) | (np.abs(height - bottom - 0.6) < 0.025))
    rim = (across > left - 0.05) & (across < right + 0.05) & (height > bottom - 0.05) & (height < top + 0.05) & ~window
    colour[bars | rim] = (0.94, 0.93, 0.90)


def wall(base: Colour, axis: int, windows: list[tuple[float, ...]], pictures: list[tuple[float, ...]]) -> Paint:
    """Return wallpaper with closed windows and pictures, for a wall along an axis.

    windows: boxes (lowest along, lowest height, highest along, highest height), m. pictures: such boxes followed by the
    number of a style.
    """

    def paint(points: F64) -> F64:
        along, height = points[:, axis], points[:, 2]
        colour = _wallpaper(points, along, base)
        for left, bottom, right, top in windows:
            _window(colour, points, along, height, (left, bottom, right, top))
        for left, bottom, right, top, style in pictures:
            _picture(colour, along, height, (left, bottom, right, top), int(style))
        return colour

    return paint


def carpet(base: Colour) -> Paint:
    """Return a flecked carpet."""
    return lambda points: _shades(base, points, 0.30, 0.04, 81) * (0.85 + 0.3 * noise(points, 0.35, 82))[:, None]


def tiles(base: Colour, size_m: float) -> Paint:
    """Return square tiles with joints, each in a different tone."""

    def paint(points: F64) -> F64:
        cell = np.floor(points / size_m)
        tone = _hash(np.stack([cell[:, 0], cell[:, 1], 0.0 * cell[:, 0]], axis=1).astype(np.int64), 83)
        colour = _shades(base, points, 0.15, 0.10, 84) * (0.85 + 0.3 * tone)[:, None]
        joint = (np.mod(points[:, 0], size_m) < 0.015) | (np.mod(points[:, 1], size_m) < 0.015)
        colour[joint] *= 0.6
        return colour

    return paint
