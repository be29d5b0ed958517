"""Folder in the format of the TUM RGB-D benchmark: rgb.txt, depth.txt and groundtruth.txt.

Sturm et al., A Benchmark for the Evaluation of RGB-D SLAM Systems, IROS 2012. Each line of the lists is a stamp in seconds and
a file name; depth is 16 bit, 5000 units a metre, registered to the colour image; groundtruth.txt has stamp tx ty tz qx qy qz qw
of the camera in optical axes. The accelerometer (accelerometer.txt) is not used: without a gyro it does not carry a pose.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from uav_recon.sensors.recordings.damaged_frames import DamagedFrames
from uav_recon.sensors.recordings.frame_stamps import used_frames
from uav_recon.sensors.recordings.image_decoding import read_depth, read_rgb
from uav_recon.sensors.recordings.recording import (
    LEVEL_MOUNT,
    DepthUnit,
    Pinhole,
    RecordingError,
    RecordingInfo,
    pinhole,
    undistorted,
)
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, StampedPose

UNITS_PER_M = 5000.0
PAIR_S = 0.02  #: reject: a depth image whose nearest colour image is farther away is skipped, as by the benchmark's own tool
_NO_TURN_SHARE = 1e-6  #: reject: a pose whose quaternion is shorter has no direction
#: internal: fx, fy, cx, cy that the benchmark names for depth registered by its driver (no distortion)
DEFAULT_K = (525.0, 525.0, 319.5, 239.5)
# the benchmark's calibrations of its colour cameras, by a part of the folder's name: fx, fy, cx, cy; k1, k2, p1, p2, k3
CALIBRATIONS: dict[str, tuple[Pinhole, tuple[float, ...]]] = {
    "freiburg1": ((517.3, 516.5, 318.6, 255.3), (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "freiburg2": ((520.9, 521.0, 325.1, 249.7), (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "freiburg3": ((535.4, 539.2, 320.1, 247.6), ()),
}


class TumFolder:
    """Recording protocol over a TUM folder.

    k: fx, fy, cx, cy; None = camera-intrinsics.txt in the folder, or the benchmark's calibration of the camera that the folder
    is named after, or its default. Both images are freed of a distortion that is known. metres_per_unit: of the depth images;
    None: 5000 units a metre. Raises RecordingError.
    """

    def __init__(self, folder: Path, k: Pinhole | None, metres_per_unit: float | None = None) -> None:
        self._folder = folder
        self._unit = DepthUnit(metres_per_unit or 1.0 / UNITS_PER_M)
        self._damaged = DamagedFrames()
        own = k or _intrinsics_file(folder)
        known = next((found for name, found in CALIBRATIONS.items() if name in folder.resolve().name), (DEFAULT_K, ()))
        self._k, self._distortion = (own, ()) if own else known
        (depth, missing), (rgb, missing_rgb) = _present(folder, "depth.txt"), _present(folder, "rgb.txt")
        self._used = used_frames(folder / "depth.txt", [stamp_s for stamp_s, _ in depth])
        self._pairs = _paired([depth[number] for number in self._used.order], sorted(rgb))
        if not self._pairs:
            raise RecordingError(
                f"{folder}: no depth image has a colour image within {PAIR_S:g} s: {_span('depth.txt', depth)}, "
                f"{_span('rgb.txt', rgb)}"
            )
        counts = {
            **self._used.skipped,
            "images listed but missing": missing + missing_rgb,
            "depth images without colour": len(self._used.order) - len(self._pairs),
        }
        self._skipped = {what: count for what, count in counts.items() if count}

    @property
    def info(self) -> RecordingInfo:
        """Return the head of the recording."""
        first_s, last_s, unit = self._pairs[0][0], self._pairs[-1][0], self._unit.metres_per_unit
        skipped = (*self._skipped.items(), *self._damaged.counts())
        return RecordingInfo(
            "TUM RGB-D folder", len(self._pairs), first_s, last_s, LEVEL_MOUNT, True, unit, skipped, self._used.remarks,
            self._used.is_part,
        )  # fmt: skip

    def frames(self, step: int = 1) -> Iterator[Frame]:
        """Yield every step-th depth image that has a colour image.

        Raises RecordingError if none can be read.
        """
        numbered = list(enumerate(self._pairs))[::step]
        return self._damaged.readable((number, partial(self._frame, number, *pair)) for number, pair in numbered)

    def _frame(self, number: int, stamp_s: float, depth_file: str, rgb_file: str) -> Frame:
        depth, rgb = read_depth(self._folder / depth_file), read_rgb(self._folder / rgb_file)
        if self._distortion:
            depth, rgb = (undistorted(image, self._k, self._distortion) for image in (depth, rgb))
        lens = pinhole(self._k, depth.shape)
        return Frame(stamp_s, number, self._unit.metres(depth), lens, rgb, pinhole(self._k, rgb.shape), Pose.identity())

    def poses(self) -> list[StampedPose]:
        """Return the poses of groundtruth.txt as poses of the body; empty without the file.

        A line whose quaternion has no direction is skipped and counted. Raises RecordingError.
        """
        path = self._folder / "groundtruth.txt"
        if not path.exists():
            return []
        optical_from_body = LEVEL_MOUNT.inverse()
        rows = list(_numbers(path, 8))
        turned = [row for row in rows if np.linalg.norm(row[4:]) > _NO_TURN_SHARE]
        if len(turned) < len(rows):
            self._skipped["poses without a rotation"] = len(rows) - len(turned)
        out = []
        for row in turned:
            world_from_optical = Pose(row[[7, 4, 5, 6]], row[1:4])
            out.append(StampedPose(float(row[0]), world_from_optical @ optical_from_body, np.zeros(3)))
        return sorted(out, key=lambda pose: pose.stamp_s)

    def imu(self) -> list[ImuSample]:
        """Return an empty list: the format has no gyro."""
        return []


def is_tum_folder(path: Path) -> bool:
    """Return True if the folder has the lists of the format."""
    return (path / "depth.txt").is_file() and (path / "rgb.txt").is_file()


def _paired(depth: list[tuple[float, str]], rgb: list[tuple[float, str]]) -> list[tuple[float, str, str]]:
    """Return (stamp, depth file, nearest colour file) for each depth image that has one.

    Rgb is sorted.
    """
    stamps_s = [stamp_s for stamp_s, _ in rgb]
    out = []
    for stamp_s, file in depth:
        after = bisect_left(stamps_s, stamp_s)
        near = min((i for i in (after - 1, after) if 0 <= i < len(rgb)), key=lambda i: abs(stamps_s[i] - stamp_s), default=None)
        if near is not None and abs(stamps_s[near] - stamp_s) <= PAIR_S:
            out.append((stamp_s, file, rgb[near][1]))
    return out


def _list(path: Path) -> list[tuple[float, str]]:
    out = []
    for number, line in _lines(path):
        words = line.split()
        try:
            stamp_s, name = float(words[0]), words[1]
        except (ValueError, IndexError):
            raise RecordingError(f"{path}: line {number} is {line[:60]!r}; want a stamp in seconds and a file name") from None
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise RecordingError(f"{path}: line {number}: {name!r} leads out of the folder")
        out.append((stamp_s, name))
    return out


def _present(folder: Path, name: str) -> tuple[list[tuple[float, str]], int]:
    """Return the entries of a list whose images exist, and how many are missing.

    Raises RecordingError if none exists.
    """
    listed = _list(folder / name)
    present = [one for one in listed if (folder / one[1]).is_file()]
    if listed and not present:
        raise RecordingError(f"{folder / name}: none of its {len(listed)} images exists, the first: {listed[0][1]}")
    return present, len(listed) - len(present)


def _span(name: str, entries: list[tuple[float, str]]) -> str:
    stamps_s = [stamp_s for stamp_s, _ in entries]
    return f"{name} is {min(stamps_s):.3f} to {max(stamps_s):.3f} s" if stamps_s else f"{name} is empty"


def _numbers(path: Path, count: int) -> Iterator[FloatArray]:
    for number, line in _lines(path):
        try:
            row = np.array([float(word) for word in line.replace(",", " ").split()])
        except ValueError:
            row = np.zeros(0)
        if row.shape != (count,) or not np.isfinite(row).all():
            raise RecordingError(f"{path}: line {number} is {line[:60]!r}; want {count} numbers")
        yield row


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror})") from None
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield number, line.strip()


def _intrinsics_file(folder: Path) -> Pinhole | None:
    from uav_recon.sensors.recordings.seven_scenes_folder import INTRINSICS, read_intrinsics

    return read_intrinsics(folder / INTRINSICS) if (folder / INTRINSICS).exists() else None
