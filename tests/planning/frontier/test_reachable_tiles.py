from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from uav_recon.planning.frontier.reachable_tiles import ReachableTiles
from uav_recon.types.frames import ByteArray, IntArray
from uav_recon.types.maps import TILE

SHAPE = (45, 37, 9)


@dataclass
class Space:
    reachable: ByteArray = field(default_factory=lambda: np.zeros([n + 2 for n in SHAPE], dtype=np.uint8))
    reachable_revision: IntArray = field(
        default_factory=lambda: np.zeros((-(-SHAPE[0] // TILE), -(-SHAPE[1] // TILE)), np.int64)
    )
    revision: int = 0

    def put(self, place: tuple[int, int, int], value: int) -> None:
        i, j, k = place
        self.revision += 1
        self.reachable[i + 1, j + 1, k + 1] = value
        self.reachable_revision[i // TILE, j // TILE] = self.revision


def test_rejects_only_if_no_reachable_voxel_is_within_the_radius() -> None:
    rng = np.random.default_rng(0)
    space, tiles = Space(), ReachableTiles()
    said = []
    for step in range(60):
        i, j, k = rng.integers(0, SHAPE).tolist()
        space.put((i, j, k), int(step % 3 > 0))
        tiles.update(space)
        voxels = np.argwhere(space.reachable[1:-1, 1:-1, 1:-1])
        for _ in range(20):
            centre, radius = rng.uniform(-3.0, np.array(SHAPE) + 3.0), rng.uniform(1.0, 12.0)
            # a voxel is within the radius if any part of it is
            near = ((voxels[:, :2] + 1 >= centre[:2] - radius) & (voxels[:, :2] <= centre[:2] + radius)).all(axis=1).any()
            said.append((bool(near), bool(tiles.near(centre[None], radius)[0])))
    assert not [near for near, answer in said if near and not answer]
    assert sum(not answer for _, answer in said) > 100
    fresh, places = ReachableTiles(), rng.uniform(0.0, SHAPE, (100, 3))
    fresh.update(space)
    np.testing.assert_array_equal(fresh.near(places, 2.0), tiles.near(places, 2.0))


def test_another_space_starts_from_scratch() -> None:
    one, other, tiles = Space(), Space(), ReachableTiles()
    one.put((3, 3, 3), 1)
    tiles.update(one)
    assert tiles.near(np.full((1, 3), 4.0), 2.0)[0]
    other.put((40, 30, 3), 0)
    tiles.update(other)
    assert not tiles.near(np.full((1, 3), 4.0), 2.0)[0]
