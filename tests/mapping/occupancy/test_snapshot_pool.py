import gc
import threading

import numpy as np

from uav_recon.mapping.occupancy.snapshot_pool import SnapshotPool
from uav_recon.types.maps import FREE, TILE, GridSpec, VoxelMap

GRID = GridSpec(np.zeros(3), 0.1, (19, 21, 5))
TILES = (3, 3)


class Painter:
    """Writer that changes one voxel at a time and remembers what every snapshot must contain."""

    def __init__(self) -> None:
        self.pictures = SnapshotPool(GRID, 1)
        self.dated = np.full(TILES, 1, dtype=np.int64)
        self.revision = 1
        self.truth = np.zeros((2, *GRID.shape), dtype=np.uint8)

    def paint(self, i: int, j: int, k: int, value: int) -> None:
        self.revision += 1
        canvas = self.pictures.writable_buffer(self.dated)
        for layer, memory in enumerate((canvas.state, canvas.distance2)):
            memory[: self.truth[0].size].reshape(GRID.shape)[i, j, k] = value + layer
            self.truth[layer, i, j, k] = value + layer
        self.dated[i // TILE, j // TILE] = self.revision

    def show(self) -> VoxelMap:
        return self.pictures.show(self.dated, self.revision, 0)


def test_snapshots_keep_their_content_while_they_are_held() -> None:
    rng = np.random.default_rng(2)
    painter, held = Painter(), []
    for _ in range(300):
        for _ in range(rng.integers(1, 4)):
            i, j, k = (int(rng.integers(n)) for n in GRID.shape)
            painter.paint(i, j, k, int(rng.integers(200)))
        picture = painter.show()
        held.append((picture, painter.truth.copy()))
        while len(held) > rng.integers(1, 5):
            held.pop(int(rng.integers(len(held))))
        for one, truth in held:
            np.testing.assert_array_equal(one.state, truth[0])
            np.testing.assert_array_equal(one.distance2, truth[1])


def test_the_memory_of_a_dropped_snapshot_is_reused_and_of_a_held_one_is_not() -> None:
    painter = Painter()
    painter.paint(0, 0, 0, FREE)
    first = painter.show()
    address = first.state.ctypes.data
    painter.paint(1, 0, 0, FREE)
    second = painter.show()
    assert second.state.ctypes.data != address
    del first
    painter.paint(2, 0, 0, FREE)
    assert painter.show().state.ctypes.data == address


def test_a_slice_of_a_snapshot_holds_it() -> None:
    painter = Painter()
    painter.paint(3, 0, 0, FREE)
    row = painter.show().state[2:5, 0][1:]
    gc.collect()
    painter.paint(3, 0, 0, 77)
    painter.show()
    assert row[0, 0] == FREE


def test_snapshots_are_read_only_and_made_without_a_copy() -> None:
    painter = Painter()
    painter.paint(0, 0, 0, FREE)
    canvas, picture = painter.pictures.current, painter.show()
    for array in (picture.state, picture.distance2, picture.tile_revision):
        assert not array.flags.writeable and array.flags.c_contiguous
    assert picture.state.ctypes.data == canvas.state.ctypes.data
    assert picture.distance2.ctypes.data == canvas.distance2.ctypes.data


def test_a_snapshot_may_be_dropped_in_another_thread() -> None:
    painter = Painter()
    painter.paint(0, 0, 0, FREE)
    held = [painter.show()]
    thread = threading.Thread(target=held.clear)
    thread.start()
    thread.join()
    assert not painter.pictures.current.shown
