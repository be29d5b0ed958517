"""Random maps to plan in: corridors, rooms with doors, clutter, noise, almost nothing; known in part, and growing.

Independent of the planner and of the mapping: distances are scipy's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from uav_recon.types.maps import FREE, OCCUPIED, TILE, UNKNOWN, GridSpec, SurfaceElements, VoxelMap

State = NDArray[np.uint8]
Point = NDArray[np.float64]

KINDS = ("corridors", "rooms", "closed doors", "clutter", "noise", "furniture", "almost nothing", "known", "shaft", "maze")
RESOLUTIONS_M = (0.05, 0.08, 0.1, 0.1, 0.15, 0.2)


@dataclass
class RandomMap:
    """truth: what there is. fence_m: (2, 3). known: what the map has seen by now."""

    kind: str
    grid: GridSpec
    truth: State
    fence_m: NDArray[np.float64]
    rng: np.random.Generator
    epoch: int = 0
    revision: int = 0
    known: NDArray[np.bool_] = field(init=False)
    _last: VoxelMap | None = None

    def __post_init__(self) -> None:
        self.known = np.zeros(self.grid.shape, dtype=np.bool_)

    def anywhere(self) -> Point:
        """A position in the grid or somewhat outside it; mostly in free space where there is any."""
        free = np.argwhere(self.truth == FREE)
        if len(free) and self.rng.random() < 0.85:
            cell = free[self.rng.integers(len(free))]
            return np.asarray(self.grid.origin_world_m + (cell + self.rng.random(3)) * self.grid.resolution_m)
        reach_m = np.array(self.grid.shape) * self.grid.resolution_m
        return np.asarray(self.grid.origin_world_m + reach_m * self.rng.uniform(-0.1, 1.1, 3))

    def look_from(self, place: Point, radius_m: float) -> None:
        """A ball of the truth becomes known, its border ragged."""
        centre = (place - self.grid.origin_world_m) / self.grid.resolution_m - 0.5
        axes = np.ogrid[tuple(slice(0, n) for n in self.grid.shape)]
        away2 = sum((axis - c) ** 2 for axis, c in zip(axes, centre, strict=True))
        radius = radius_m / self.grid.resolution_m
        self.known |= np.asarray(away2 <= radius**2 * self.rng.uniform(0.7, 1.0))
        if self.kind == "noise":
            self.known &= self.rng.random(self.grid.shape) > 0.01

    def change(self) -> None:
        """Something appears, or goes."""
        low = self.rng.integers(0, self.grid.shape)
        box = tuple(slice(a, a + n) for a, n in zip(low, self.rng.integers(1, 6, 3), strict=True))
        self.truth[box] = self.rng.choice([FREE, OCCUPIED])
        self._fence_in()

    def snapshot(self) -> VoxelMap:
        """The map as it is known now, its changed tiles told as a mapper tells them."""
        state = np.where(self.known, self.truth, UNKNOWN).astype(np.uint8)
        away = ndimage.distance_transform_edt(np.pad(state == FREE, 1))[1:-1, 1:-1, 1:-1]
        reach = min(int(np.ceil(1.1 / self.grid.resolution_m)), 15)
        distance2 = np.round(np.minimum(away, reach) ** 2).astype(np.uint8)
        self.revision += 1
        if self._last is None or self._last.map_epoch != self.epoch:
            self._last = VoxelMap.whole(self.grid, state, distance2, self.revision, self.epoch)
            return self._last
        differs = ((state != self._last.state) | (distance2 != self._last.distance2)).any(axis=2)
        nx, ny = self._last.tile_revision.shape
        padded = np.zeros((nx * TILE, ny * TILE), dtype=np.bool_)
        padded[: differs.shape[0], : differs.shape[1]] = differs
        tiles = padded.reshape(nx, TILE, ny, TILE).any(axis=(1, 3))
        revisions = np.where(tiles, self.revision, self._last.tile_revision)
        self._last = VoxelMap(self.grid, state, distance2, revisions, self.revision, self.epoch)
        return self._last

    def surface(self) -> SurfaceElements | None:
        """Elements on known faces between free and occupied, normals into the free; none where there are none."""
        state = np.where(self.known, self.truth, UNKNOWN)
        positions, normals = [], []
        for axis in range(3):
            for sign in (-1, 1):
                beside = np.roll(state, -sign, axis=axis)
                inner = [slice(None)] * 3
                inner[axis] = slice(1, -1)
                cells = np.argwhere((state == OCCUPIED)[tuple(inner)] & (beside == FREE)[tuple(inner)]).astype(np.float64)
                cells[:, axis] += 1
                normal = np.zeros(3)
                normal[axis] = sign
                positions.append(cells + 0.5 + normal * 0.5)
                normals.append(np.tile(normal, (len(cells), 1)))
        position = np.concatenate(positions)
        if not len(position):
            return None
        kept = self.rng.choice(len(position), size=min(len(position), 800), replace=False)
        world = self.grid.origin_world_m + position[kept] * self.grid.resolution_m
        return SurfaceElements(world, np.concatenate(normals)[kept], self.rng.uniform(0.1, 1.0, len(kept)), self.revision)

    def _fence_in(self) -> None:
        """Outside the fence nothing is ever free."""
        axes = (np.arange(n) for n in self.grid.shape)
        centres = self.grid.centre(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))
        outside = np.any((centres < self.fence_m[0]) | (centres > self.fence_m[1]), axis=-1)
        self.truth[outside & (self.truth == FREE)] = UNKNOWN


def random_map(seed: int) -> RandomMap:
    """One map of a kind that the seed chooses."""
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    resolution_m = float(rng.choice(RESOLUTIONS_M))
    size_m = np.array([rng.uniform(1.2, 6.0), rng.uniform(1.2, 6.0), rng.uniform(0.9, 3.2)])
    nx, ny, nz = (int(n) for n in np.clip(size_m / resolution_m, 4, [56, 56, 40]).astype(int))
    grid = GridSpec(np.round(rng.uniform(-3, 3, 3) / resolution_m) * resolution_m, resolution_m, (nx, ny, nz))
    truth = _BUILDERS[kind](rng, grid.shape, resolution_m)
    extent_m = np.array(grid.shape) * resolution_m
    inset = rng.uniform(0.0, 0.15, (2, 3)) if rng.random() < 0.4 else np.zeros((2, 3))
    fence_m = np.stack([grid.origin_world_m + inset[0] * extent_m, grid.origin_world_m + (1 - inset[1]) * extent_m])
    made = RandomMap(kind, grid, truth, fence_m, rng)
    made._fence_in()
    return made


def _boxes(rng: np.random.Generator, state: State, count: int, largest: int, value: int) -> State:
    for _ in range(count):
        low = rng.integers(0, state.shape)
        high = low + rng.integers(1, largest, 3)
        state[low[0] : high[0], low[1] : high[1], low[2] : high[2]] = value
    return state


def _shell(_rng: np.random.Generator, shape: tuple[int, ...], _resolution_m: float) -> State:
    state = np.full(shape, OCCUPIED, dtype=np.uint8)
    state[1:-1, 1:-1, 1:-1] = FREE
    return state


def _corridors(rng: np.random.Generator, shape: tuple[int, ...], resolution_m: float) -> State:
    state = np.full(shape, OCCUPIED, dtype=np.uint8)
    at = rng.integers(2, np.maximum(np.array(shape) - 2, 3))
    for leg in range(rng.integers(2, 7)):
        axis, width = (leg + int(rng.integers(2))) % 2, (rng.uniform(0.6, 2.0, 3) / resolution_m).astype(int)
        to = at.copy()
        to[axis] = rng.integers(0, shape[axis])
        low, high = np.minimum(at, to), np.maximum(at, to) + width
        state[max(low[0], 1) : high[0], max(low[1], 1) : high[1], 1 : high[2] + 4] = FREE
        at = to
    state[-1], state[:, -1], state[:, :, -1] = OCCUPIED, OCCUPIED, OCCUPIED
    return state


def _rooms(rng: np.random.Generator, shape: tuple[int, ...], resolution_m: float, door: bool = True) -> State:
    state = _shell(rng, shape, resolution_m)
    for axis in (0, 1):
        for wall in range(int(rng.integers(12, 22)), shape[axis] - 5, int(rng.integers(14, 26))):
            across = shape[1 - axis]
            slab: list[slice | int] = [slice(None)] * 3
            slab[axis] = wall
            state[tuple(slab)] = OCCUPIED
            if door:
                at = int(rng.integers(1, max(across - 10, 2)))
                slab[1 - axis], slab[2] = (
                    slice(at, at + int(rng.uniform(0.1, 1.8) / resolution_m)),
                    slice(1, int(rng.uniform(0.4, 2.4) / resolution_m)),
                )
                state[tuple(slab)] = FREE
    state[[0, -1]], state[:, [0, -1]], state[:, :, [0, -1]] = OCCUPIED, OCCUPIED, OCCUPIED
    return state


def _noise(rng: np.random.Generator, shape: tuple[int, ...], resolution_m: float) -> State:
    state = _shell(rng, shape, resolution_m)
    state[rng.random(shape) < rng.choice([0.0001, 0.0005, 0.005])] = OCCUPIED
    return state


def _almost_nothing(rng: np.random.Generator, shape: tuple[int, ...], _resolution_m: float) -> State:
    """One free voxel, or none."""
    state = np.full(shape, rng.choice([UNKNOWN, OCCUPIED]), dtype=np.uint8)
    if rng.random() < 0.5:
        state[tuple(rng.integers(0, shape))] = FREE
    return state


def _shaft(rng: np.random.Generator, shape: tuple[int, ...], resolution_m: float) -> State:
    """Floors of several heights joined by holes: ways that climb."""
    state = _shell(rng, shape, resolution_m)
    for floor in range(int(rng.uniform(0.9, 1.5) / resolution_m), shape[2] - 4, int(rng.uniform(0.9, 1.5) / resolution_m)):
        state[:, :, floor] = OCCUPIED
        low = rng.integers(1, np.maximum(np.array(shape[:2]) - 10, 2))
        high = low + (rng.uniform(0.5, 1.8, 2) / resolution_m).astype(int)
        state[low[0] : high[0], low[1] : high[1], floor] = FREE
    return state


def _clutter(rng: np.random.Generator, shape: tuple[int, ...], resolution_m: float) -> State:
    state = _boxes(rng, _shell(rng, shape, resolution_m), 5, 14, OCCUPIED)
    return _boxes(rng, state, 3, 12, UNKNOWN)


_BUILDERS: dict[str, Callable[[np.random.Generator, tuple[int, ...], float], State]] = {
    "corridors": _corridors,
    "rooms": _rooms,
    "closed doors": lambda rng, shape, resolution_m: _rooms(rng, shape, resolution_m, door=False),
    "clutter": _clutter,
    "noise": _noise,
    "furniture": lambda rng, shape, resolution_m: _boxes(rng, _rooms(rng, shape, resolution_m), 6, 9, OCCUPIED),
    "almost nothing": _almost_nothing,
    "known": _shell,
    "shaft": _shaft,
    "maze": lambda rng, shape, resolution_m: np.minimum(
        _corridors(rng, shape, resolution_m), _corridors(rng, shape, resolution_m)
    ),
}
