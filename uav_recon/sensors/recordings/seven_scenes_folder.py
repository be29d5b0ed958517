"""Folder in the format of 7-Scenes.

Files: frame-NNNNNN.color.*, .depth.png and .pose.txt, and camera-intrinsics.txt.

Shotton et al., Scene Coordinate Regression Forests, CVPR 2013. Depth is 16 bit in millimetres, 0 and 65535 are no return;
pose.txt is the matrix (4, 4) world_from_camera in optical axes. The format has no stamps: the frames are 1/30 s apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from uav_recon.sensors.recordings.damaged_frames import DamagedFrames
from uav_recon.sensors.recordings.frame_stamps import require_increasing
from uav_recon.sensors.recordings.image_decoding import read_depth, read_rgb
from uav_recon.sensors.recordings.recording import (
    LEVEL_MOUNT,
    MM,
    DepthUnit,
    Pinhole,
    RecordingError,
    RecordingInfo,
    pinhole,
)
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, StampedPose

RATE_HZ = 30.0
INTRINSICS = "camera-intrinsics.txt"
#: internal: fx, fy, cx, cy of the 7-Scenes camera, as its authors give them
DEFAULT_K = (585.0, 585.0, 320.0, 240.0)
# the colour camera of 7-Scenes, which its authors did not calibrate: fx, fy, cx, cy of a Kinect, and where it is beside depth
COLOUR_K = (525.0, 525.0, 319.5, 239.5)
RGB_FROM_DEPTH = Pose(np.array([1.0, 0.0, 0.0, 0.0]), np.array([-0.025, 0.0, 0.0]))
_NO_ROTATION_SHARE = 0.01  #: reject: a pose whose matrix is farther from a rotation, for example all zero or not a number


class SevenScenesFolder:
    """Recording protocol over a folder of 7-Scenes or tsdf-fusion-python.

    k: fx, fy, cx, cy; None = camera-intrinsics.txt in the folder, or the values of 7-Scenes. metres_per_unit: of the depth
    images; None: millimetres. A frame whose pose is missing or is no rotation has no pose. Raises RecordingError.
    """

    def __init__(self, folder: Path, k: Pinhole | None, metres_per_unit: float | None = None) -> None:
        self._unit = DepthUnit(metres_per_unit or MM)
        self._damaged = DamagedFrames()
        self._k = k or (read_intrinsics(folder / INTRINSICS) if (folder / INTRINSICS).exists() else DEFAULT_K)
        files = folder.glob("frame-*.depth.png")
        try:
            numbered = sorted((int(path.name.split(".")[0].removeprefix("frame-")), path) for path in files)
        except ValueError:
            raise RecordingError(f"{folder}: want frame-NNNNNN.depth.png with a number") from None
        self._numbers, self._depth = [number for number, _ in numbered], [path for _, path in numbered]
        require_increasing(folder, [number / RATE_HZ for number in self._numbers])

    @property
    def info(self) -> RecordingInfo:
        """Return the head of the recording."""
        first_s, last_s = self._numbers[0] / RATE_HZ, self._numbers[-1] / RATE_HZ
        unit, skipped = self._unit.metres_per_unit, self._damaged.counts()
        return RecordingInfo("7-Scenes folder", len(self._depth), first_s, last_s, LEVEL_MOUNT, False, unit, skipped)

    def frames(self, step: int = 1) -> Iterator[Frame]:
        """Yield every step-th frame, by number. Raises RecordingError if none can be read."""
        numbered = zip(self._numbers[::step], self._depth[::step], strict=True)
        return self._damaged.readable((number, partial(self._frame, number, path)) for number, path in numbered)

    def _frame(self, number: int, path: Path) -> Frame:
        depth, rgb = read_depth(path), read_rgb(self._colour_of(path))
        lens = pinhole(self._k, depth.shape)
        scale = rgb.shape[1] / depth.shape[1]
        raw = self._k == DEFAULT_K  # else colour is registered: the same view at another resolution
        fx, fy, cx, cy = COLOUR_K if raw else self._k
        moved = RGB_FROM_DEPTH if raw else Pose.identity()
        rgb_k = (fx * scale, fy * scale, (cx + 0.5) * scale - 0.5, (cy + 0.5) * scale - 0.5)
        return Frame(number / RATE_HZ, number, self._unit.metres(depth), lens, rgb, pinhole(rgb_k, rgb.shape), moved)

    def poses(self) -> list[StampedPose]:
        """Return the poses of the frames that have one, as poses of the body."""
        optical_from_body = LEVEL_MOUNT.inverse()
        found = ((number, _read_pose(path)) for number, path in zip(self._numbers, self._depth, strict=True))
        return [
            StampedPose(number / RATE_HZ, pose @ optical_from_body, np.zeros(3)) for number, pose in found if pose is not None
        ]

    def imu(self) -> list[ImuSample]:
        """Return an empty list: the format has no inertial samples."""
        return []

    @staticmethod
    def _colour_of(depth: Path) -> Path:
        stem = depth.name.removesuffix(".depth.png")
        png = depth.with_name(f"{stem}.color.png")
        return png if png.exists() else depth.with_name(f"{stem}.color.jpg")


def is_seven_scenes_folder(path: Path) -> bool:
    """Return True if the folder has a depth image of the format."""
    return next(path.glob("frame-*.depth.png"), None) is not None


def read_intrinsics(path: Path) -> Pinhole:
    """Return fx, fy, cx, cy of a file with the matrix (3, 3). Raises RecordingError."""
    matrix = _matrix(path, 3)
    if matrix is None:
        raise RecordingError(f"{path}: want a matrix of 3 x 3 numbers")
    fx, fy, cx, cy = (float(matrix[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    if not (fx > 0 and fy > 0):
        raise RecordingError(f"{path}: fx {fx:g} and fy {fy:g} must be positive")
    return fx, fy, cx, cy


def _read_pose(depth: Path) -> Pose | None:
    path = depth.with_name(depth.name.removesuffix("depth.png") + "pose.txt")
    matrix = _matrix(path, 4) if path.exists() else None
    if matrix is None or np.abs(matrix[:3, :3] @ matrix[:3, :3].T - np.eye(3)).max() > _NO_ROTATION_SHARE:
        return None
    if np.linalg.det(matrix[:3, :3]) < 0.0:  # mirrored
        return None
    return Pose.from_matrix(matrix)


def _matrix(path: Path, size: int) -> FloatArray | None:
    """Return a matrix (size, size); None if the file holds anything else.

    Raises RecordingError if it cannot be read.
    """
    try:
        numbers = np.array([float(word) for word in path.read_text().split()])
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError:
        return None
    return numbers.reshape(size, size) if numbers.size == size * size and np.isfinite(numbers).all() else None
