"""Recording of a camera stream with poses in one .npz file, for a calibration by hand.

Arrays: frame_stamp_s (N,), depth_mm (N, H, W) uint16 with 0 = no return, rgb (N, h, w, 3) uint8, depth_intrinsics and
rgb_intrinsics (6,) fx fy cx cy width height, rgb_from_depth (7,) wxyz and metres, pose_stamp_s (M,), pose_position_m (M, 3),
pose_quat_wxyz (M, 4); optional imu_stamp_s (K,), gyro_radps (K, 3), specific_force_mps2 (K, 3).
"""

from __future__ import annotations

from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from uav_recon.interfaces import Clock
from uav_recon.sensors.recordings.checked_recording import faults_of
from uav_recon.sensors.recordings.frame_stamps import require_increasing
from uav_recon.sensors.recordings.recording import MM
from uav_recon.sensors.stream_camera import depth_lookup_table
from uav_recon.sensors.stream_format import StreamError
from uav_recon.types.camera import Frame, ImuSample, Intrinsics
from uav_recon.types.frames import AnyArray, FloatArray
from uav_recon.types.pose import Pose, StampedPose

_NEEDED = (
    "frame_stamp_s", "depth_mm", "rgb", "depth_intrinsics", "rgb_intrinsics", "rgb_from_depth", "pose_stamp_s",
    "pose_position_m", "pose_quat_wxyz",
)  # fmt: skip
_NO_TURN_SHARE = 1e-6  #: reject: a quaternion that is shorter has no direction


class NpzRecording:
    """Camera and pose source over a file; values come once the clock has reached their stamps.

    No call blocks.

    metres_per_unit: of depth_mm; None: millimetres. Raises StreamError (one line) for a file that cannot be used. begin_s,
    end_s: its first and last stamp.
    """

    def __init__(
        self, path: Path, clock: Clock, depth_min_m: float, depth_max_m: float, metres_per_unit: float | None = None
    ) -> None:
        data = self._data = _load(path)
        self._frame_s, self._pose_s = _stamps(path, data, "frame_stamp_s"), _stamps(path, data, "pose_stamp_s")
        self._imu_s = _stamps(path, data, "imu_stamp_s") if "imu_stamp_s" in data else np.empty(0)
        self._lenses = _lens(path, data, "depth_intrinsics"), _lens(path, data, "rgb_intrinsics")
        frames, poses, samples = len(self._frame_s), len(self._pose_s), len(self._imu_s)
        _require(path, data, "depth_mm", (frames, self._lenses[0].height, self._lenses[0].width), np.uint16)
        _require(path, data, "rgb", (frames, *data["rgb"].shape[1:3], 3), np.uint8)  # of any size: it is not used
        _require(path, data, "pose_position_m", (poses, 3))
        _require(path, data, "pose_quat_wxyz", (poses, 4))
        _require(path, data, "rgb_from_depth", (7,))
        for name in ("gyro_radps", "specific_force_mps2") if samples else ():
            _require(path, data, name, (samples, 3))
        for name, quats in (("pose_quat_wxyz", data["pose_quat_wxyz"]), ("rgb_from_depth", data["rgb_from_depth"][None, :4])):
            if np.linalg.norm(quats, axis=1).min() < _NO_TURN_SHARE:
                raise StreamError(f"{path}: {name}: has a quaternion without a direction")
        self._rgb_from_depth = Pose(data["rgb_from_depth"][:4], data["rgb_from_depth"][4:])
        self._table = depth_lookup_table(depth_min_m, depth_max_m, metres_per_unit or MM)
        self._clock = clock
        self._frame = self._pose = self._sample = 0
        self.begin_s = float(min(self._frame_s[0], self._pose_s[0]))
        self.end_s = float(max(self._frame_s[-1], self._pose_s[-1]))

    def poll(self) -> Frame | None:
        """Return the newest frame that is due, once, else None."""
        due = int(np.searchsorted(self._frame_s, self._clock.now_s(), side="right"))
        if due == self._frame:
            return None
        self._frame = due
        n, (depth, rgb) = due - 1, self._lenses
        depth_m = self._table[self._data["depth_mm"][n]]
        return Frame(float(self._frame_s[n]), n, depth_m, depth, self._data["rgb"][n], rgb, self._rgb_from_depth)

    def imu(self) -> list[ImuSample]:
        """Return the inertial samples that became due since the last call."""
        due = int(np.searchsorted(self._imu_s, self._clock.now_s(), side="right"))
        rows, self._sample = range(self._sample, due), due
        return [
            ImuSample(float(self._imu_s[k]), self._data["gyro_radps"][k], self._data["specific_force_mps2"][k]) for k in rows
        ]

    def poses(self) -> list[StampedPose]:
        """Return the poses that became due since the last call."""
        due = int(np.searchsorted(self._pose_s, self._clock.now_s(), side="right"))
        rows, self._pose = range(self._pose, due), due
        places = [Pose(self._data["pose_quat_wxyz"][k], self._data["pose_position_m"][k]) for k in rows]
        return [StampedPose(float(self._pose_s[k]), place, np.zeros(3)) for k, place in zip(rows, places, strict=True)]

    def close(self) -> None:
        """Do nothing: no resource is open."""


def _load(path: Path) -> dict[str, AnyArray]:
    """Return the arrays of a file. Raises StreamError."""
    data: dict[str, AnyArray] = {}
    with faults_of(path), path.open("rb") as opened:
        try:
            file = np.load(opened, allow_pickle=False)
        except (ValueError, BadZipFile, EOFError):
            raise StreamError(f"{path}: not a recording: want an .npz file") from None
        if not isinstance(file, np.lib.npyio.NpzFile):
            raise StreamError(f"{path}: not a recording: want an .npz file")
        for name in file.files:
            with faults_of(f"{path}: {name}"):
                data[name] = file[name]
    missing = [name for name in _NEEDED if name not in data]
    if missing:
        raise StreamError(f"{path}: not a recording: no array {missing[0]}")
    return data


def _require(path: Path, data: dict[str, AnyArray], name: str, shape: tuple[int, ...], kind: type = np.float64) -> None:
    """Raise StreamError unless an array has this shape and kind, and finite numbers."""
    array = data.get(name)
    if array is None or array.shape != shape or not np.can_cast(array.dtype, kind):
        found = "missing" if array is None else f"{array.dtype} of shape {array.shape}"
        raise StreamError(f"{path}: {name}: is {found}; want {np.dtype(kind)} of shape {shape}")
    if not np.isfinite(array).all():
        raise StreamError(f"{path}: {name}: has a number that is not finite")


def _stamps(path: Path, data: dict[str, AnyArray], name: str) -> FloatArray:
    _require(path, data, name, (data[name].size,))
    stamps_s = np.asarray(data[name], dtype=np.float64)
    require_increasing(Path(f"{path}: {name}"), stamps_s.tolist())
    return stamps_s


def _lens(path: Path, data: dict[str, AnyArray], name: str) -> Intrinsics:
    _require(path, data, name, (6,))
    numbers = np.asarray(data[name], dtype=np.float64)
    if min(*numbers[:2], *numbers[4:]) <= 0.0:
        raise StreamError(f"{path}: {name}: want fx fy cx cy width height, with positive focal lengths and sizes")
    fx, fy, cx, cy, width, height = numbers.tolist()
    return Intrinsics(fx, fy, cx, cy, int(width), int(height))
