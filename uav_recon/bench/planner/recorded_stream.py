"""A recorded depth stream, the input of the planner benchmark.

A folder holds:

- meta.json: {room [[x0,y0,z0],[x1,y1,z1]], max_range_m, "WxH" {fx, fy, cx, cy}}
- poses.npy: (N, 4, 4) T_world_camera, optical axes
- depth_WxH.npz: depth_mm (N, H, W) uint16
- occupancy_reference.i8 (optional): 0.1 m voxels from the room's lower corner, C order, 0 unknown, 1 free, 2 occupied
- atsp/ (optional): cost matrices with known tours
"""

from __future__ import annotations

import json
import re
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uav_recon.app.option_validation import UsageError, readable
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame
from uav_recon.types.frames import AnyArray, ByteArray, FloatArray
from uav_recon.types.maps import GridSpec
from uav_recon.types.pose import Pose

RESOLUTION_M = 0.1
# In such a stream a zero means "no return within the range", so space is free up to the range. From a real camera a zero is
# a hole, and the space is unknown. A depth of this many ranges frees up to the range and marks nothing occupied.
FAR_RANGES = 4.0
# defaults
SIZE = "640x480"
STRIDE = 2
MAX_STRIDE = 8
_NO_COLOUR = np.zeros((1, 1, 3), dtype=np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class RecordedStream:
    """Frames with their poses in a room with a known box (3,), (3,) in metres.

    stride: every stride-th row and column of an image is used.
    reference: reference map, or None.
    """

    name: str
    frames: tuple[PosedFrame, ...]
    lens: Intrinsics
    low_m: FloatArray
    high_m: FloatArray
    max_range_m: float
    stride: int = 1
    reference: ByteArray | None = None
    folder: Path | None = None

    @property
    def grid(self) -> GridSpec:
        """Return the grid that covers the room exactly."""
        return GridSpec.covering(self.low_m, self.high_m, RESOLUTION_M)


def recorded(depth_m: AnyArray, world_from_camera: Pose, lens: Intrinsics, sequence: int) -> PosedFrame:
    """Return one frame; depth_m (H, W) float32, NaN = no return."""
    stamp_s = sequence * 0.1
    return PosedFrame(Frame(stamp_s, sequence, depth_m, lens, _NO_COLOUR, lens, Pose.identity()), world_from_camera)


def load(folder: Path, size: str = SIZE, stride: int = STRIDE) -> RecordedStream:
    """Read a stream at one of its sizes. Raises UsageError with one line for bad input."""
    with readable(f"--stream {folder}"):
        there = folder.is_dir()
    if not there:
        raise UsageError(f"--stream {folder}: no such folder; want a folder with meta.json, poses.npy and depth_WxH.npz")
    if not 1 <= stride <= MAX_STRIDE:
        raise UsageError(f"--stride {stride}: want 1 to {MAX_STRIDE}")
    meta = _meta(folder / "meta.json")
    sizes = sorted(key for key in meta if re.fullmatch(r"\d+x\d+", key))
    if not sizes:
        raise UsageError(f"{folder / 'meta.json'}: names no image size (a key as {SIZE} with fx, fy, cx, cy)")
    if size not in sizes:
        raise UsageError(f"--size {size}: want one of {', '.join(sizes)}, the sizes of {folder / 'meta.json'}")
    width, height = map(int, size.split("x"))
    try:
        focal = {key: float(meta[size][key]) for key in ("fx", "fy", "cx", "cy")}
        low_m, high_m = np.array(meta["room"], dtype=np.float64)
        max_range_m = float(meta["max_range_m"])
    except (KeyError, TypeError, ValueError) as error:
        raise UsageError(f"{folder / 'meta.json'}: {error}; want room, max_range_m and {size} with fx, fy, cx, cy") from None
    lens = Intrinsics(**focal, width=width, height=height)
    poses = _array(folder / "poses.npy")
    depth_mm = _array(folder / f"depth_{size}.npz", "depth_mm")
    _expect(folder / "poses.npy", poses, (len(depth_mm), 4, 4))
    _expect(folder / f"depth_{size}.npz", depth_mm, (len(poses), height, width))
    far_m = FAR_RANGES * max_range_m
    frames = tuple(
        recorded(_metres(depth, far_m), Pose.from_matrix(matrix), lens, n)
        for n, (depth, matrix) in enumerate(zip(depth_mm, poses, strict=True))
    )
    reference = _reference(folder, GridSpec.covering(low_m, high_m, RESOLUTION_M))
    return RecordedStream(folder.name, frames, lens, low_m, high_m, max_range_m, stride, reference, folder)


def _metres(depth_mm: AnyArray, far_m: float) -> AnyArray:
    return np.where(depth_mm == 0, np.float32(far_m), depth_mm * np.float32(1e-3)).astype(np.float32)


def _meta(path: Path) -> dict[str, Any]:
    try:
        meta = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path}: not JSON: {error}") from None
    if not isinstance(meta, dict):
        raise UsageError(f"{path}: want an object with room, max_range_m and sizes")
    return meta


def _array(path: Path, key: str | None = None) -> AnyArray:
    try:
        with path.open("rb") as file:
            loaded = np.load(file, allow_pickle=False)
            return np.asarray(loaded if key is None else loaded[key])
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror or error})") from None
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise UsageError(f"{path}: not the array that it should be: {error}") from None


def _expect(path: Path, array: AnyArray, shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise UsageError(f"{path}: shape {array.shape}, want {shape}")


def _reference(folder: Path, grid: GridSpec) -> ByteArray | None:
    path = folder / "occupancy_reference.i8"
    if not path.exists():
        return None
    try:
        values = np.fromfile(path, dtype=np.int8)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror})") from None
    if values.size != int(np.prod(grid.shape)):
        raise UsageError(f"{path}: {values.size} voxels, want {int(np.prod(grid.shape))} for {grid.shape}")
    return values.astype(np.uint8).reshape(grid.shape)
