"""Keyframes on disk, in a folder that other programs can read.

folder/NNNN_rgb.jpg, folder/NNNN_depth.png (16 bit, millimetres as the camera reported them, 0 = no return) and
folder/poses.json with the intrinsics, poses and stamps of all keyframes. "calibration" of a keyframe holds the errors of the
camera as known when it was taken: divide depth by 1 + depth_scale; world_from_depth is corrected for the delay and for the pose
of the imager. "velocity_mps" and "rate_radps" are the motion of the imager, in world. Each file is replaced atomically. All
poses belong to one map epoch. A keyframe whose pose is unknown in a new epoch has a null pose and keeps its number.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from uav_recon import atomic_file
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame
from uav_recon.types.camera_calibration import CameraCalibration
from uav_recon.types.frames import AnyArray, FloatArray
from uav_recon.types.pose import MapCorrection, Pose

JPEG_QUALITY = 95
PNG_COMPRESSION = 1
# of poses.json: one line per keyframe
HEAD = '{"depth_unit_m": 0.001, "keyframes": [\n'
BETWEEN = ",\n"
TAIL = "\n]}\n"
_AT_REST = (0.0, 0.0, 0.0)


class KeyframeError(Exception):
    """Raised for a keyframe folder that cannot be read; the text names the file and the fault."""


class KeyframeFolder:
    """A keyframe folder with one writer and any number of readers.

    The constructor creates the folder and reads existing keyframes. Raises OSError if the folder cannot be created,
    KeyframeError if its poses.json is damaged.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self._entries: list[dict[str, Any]] = []
        self._lines = ""  # poses.json as text: refresh() parses and save() serialises only new entries
        self.refresh()

    def __len__(self) -> int:
        return len(self._entries)

    def refresh(self) -> None:
        """Read the keyframes that another process wrote.

        Raises KeyframeError if poses.json is damaged.
        """
        path = self.folder / "poses.json"
        if not path.exists():
            return
        try:
            text = path.read_text(encoding="utf-8")
            if text.startswith(HEAD) and text.startswith(self._lines, len(HEAD)) and text.endswith(TAIL):
                fresh = text[len(HEAD) + len(self._lines) : -len(TAIL)]
                self._entries += json.loads(f"[{fresh.removeprefix(BETWEEN)}]")
                self._lines += fresh
            else:
                self._entries = json.loads(text)["keyframes"]
                self._lines = BETWEEN.join(json.dumps(entry) for entry in self._entries)
        except RecursionError:
            raise KeyframeError(f"{path}: not a list of keyframes (nested too deeply)") from None
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise KeyframeError(f"{path}: not a list of keyframes ({error})") from None

    def stamp_s(self, number: int) -> float:
        """Return the capture time of a keyframe. Raises IndexError if there is no such keyframe."""
        return float(self._entries[number]["stamp_s"])

    @property
    def map_epoch(self) -> int:
        """Map epoch of all poses; 0 without keyframes."""
        return int(self._entries[-1]["map_epoch"]) if self._entries else 0

    def pose(self, number: int) -> Pose | None:
        """Return world_from_depth of a keyframe in the current map epoch, or None if it is unknown.

        Raises KeyframeError if the entry is damaged.
        """
        try:
            entry = self._entries[number]["world_from_depth"]
            return None if entry is None else _read_pose(entry)
        except (IndexError, KeyError, TypeError, ValueError, OverflowError) as error:
            raise KeyframeError(f"{self.folder}: keyframe {number}: {error}") from None

    def repose(self, correction: MapCorrection) -> None:
        """Replace the poses of all keyframes, matched by stamp, by those of a new map epoch.

        A keyframe without a pose in the correction gets a null pose. Raises OSError if the file cannot be written.
        """
        where = dict(correction.poses())
        entries = []
        for entry in self._entries:
            pose = where.get(float(entry["stamp_s"]))
            there = {"map_epoch": correction.map_epoch, "world_from_depth": None if pose is None else _pose(pose)}
            entries.append(entry | there)
        lines = BETWEEN.join(json.dumps(entry) for entry in entries)
        atomic_file.replace(self.folder / "poses.json", (HEAD + lines + TAIL).encode(), durable=False)
        self._entries = entries
        self._lines = lines

    def save(self, keyframe: PosedFrame) -> int:
        """Write a keyframe and return its number. Blocks for about 10 ms.

        Raises OSError if a file cannot be written.
        """
        import cv2

        frame, number = keyframe.frame, len(self._entries)
        with np.errstate(over="ignore"):  # an overflow becomes infinite, which means no return
            reported_m = keyframe.calibration.reported_depth_m(frame.depth_m)
            millimetres = np.nan_to_num(reported_m * 1000.0, nan=0.0, posinf=0.0, neginf=0.0)
        depth = np.where(millimetres < 65535.0, np.rint(millimetres), 0.0).astype(np.uint16)
        bgr = np.ascontiguousarray(frame.rgb[:, :, ::-1])
        self._write(f"{number:04d}_rgb.jpg", cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]))
        self._write(f"{number:04d}_depth.png", cv2.imencode(".png", depth, [cv2.IMWRITE_PNG_COMPRESSION, PNG_COMPRESSION]))
        entry = {
            "rgb": f"{number:04d}_rgb.jpg",
            "depth": f"{number:04d}_depth.png",
            "stamp_s": frame.stamp_s,
            "sequence": frame.sequence,
            "map_epoch": keyframe.map_epoch,
            "depth_intrinsics": _lens(frame.depth_intrinsics),
            "rgb_intrinsics": _lens(frame.rgb_intrinsics),
            "rgb_from_depth": _pose(frame.rgb_from_depth),
            "world_from_depth": _pose(keyframe.world_from_depth),
            "calibration": _calibration(keyframe.calibration),
            "velocity_mps": keyframe.velocity_mps.tolist(),
            "rate_radps": keyframe.rate_radps.tolist(),
        }
        self._entries.append(entry)
        self._lines += (BETWEEN if self._lines else "") + json.dumps(entry)
        atomic_file.replace(self.folder / "poses.json", (HEAD + self._lines + TAIL).encode(), durable=False)
        return number

    def load(self, number: int) -> PosedFrame:
        """Read a keyframe. Raises KeyframeError if it is missing, damaged or without a pose."""
        import cv2

        try:
            entry, pose = self._entries[number], self.pose(number)
            if pose is None:
                raise KeyframeError(f"{self.folder}: keyframe {number} has no place in map epoch {self.map_epoch}")
            depth = cv2.imread(str(self._image(entry["depth"])), cv2.IMREAD_UNCHANGED)
            bgr = cv2.imread(str(self._image(entry["rgb"])), cv2.IMREAD_COLOR)
            if depth is None or bgr is None or depth.dtype != np.uint16:
                raise KeyframeError(f"{self.folder}: images of keyframe {number} are missing or damaged")
            calibration = _read_calibration(entry["calibration"]) if "calibration" in entry else CameraCalibration.none()
            reported_m = np.where(depth > 0, depth.astype(np.float32) * np.float32(0.001), np.float32(np.nan))
            frame = Frame(
                float(entry["stamp_s"]),
                int(entry["sequence"]),
                calibration.true_depth_m(reported_m),
                _read_lens(entry["depth_intrinsics"]),
                np.ascontiguousarray(bgr[:, :, ::-1]),
                _read_lens(entry["rgb_intrinsics"]),
                _read_pose(entry["rgb_from_depth"]),
            )
            motion = [_vector(entry.get(name, _AT_REST)) for name in ("velocity_mps", "rate_radps")]
            return PosedFrame(frame, pose, int(entry["map_epoch"]), False, math.nan, calibration, *motion)
        except (IndexError, KeyError, TypeError, ValueError, OverflowError) as error:
            raise KeyframeError(f"{self.folder}: keyframe {number}: {error}") from None

    def _image(self, name: str) -> Path:
        """Return the path of an image. Raises ValueError for a name that leads out of the folder."""
        if not name or name == ".." or Path(name).name != name:
            raise ValueError(f"file name {name!r} leads out of the folder")
        return self.folder / name

    def _write(self, name: str, encoded: tuple[bool, AnyArray]) -> None:
        ok, data = encoded
        if not ok:
            raise OSError(f"{self.folder / name}: image could not be encoded")
        # not durable: a sync for each image would take longer than the writing
        atomic_file.replace(self.folder / name, data.tobytes(), durable=False)


def _lens(lens: Intrinsics) -> dict[str, float | int]:
    return {name: getattr(lens, name) for name in ("fx", "fy", "cx", "cy", "width", "height")}


def _read_lens(entry: Any) -> Intrinsics:
    try:
        return Intrinsics.from_tree(entry)
    except (KeyError, TypeError) as error:
        raise ValueError(f"intrinsics: {error}") from None


def _calibration(calibration: CameraCalibration) -> dict[str, Any]:
    return {
        "delay_s": calibration.delay_s,
        "nominal_from_true": _pose(calibration.nominal_from_true),
        "depth_scale": calibration.scale,
        "width": calibration.width,
    }


def _read_calibration(entry: Any) -> CameraCalibration:
    numbers = [float(entry[name]) for name in ("delay_s", "depth_scale", "width")]
    if not all(math.isfinite(x) for x in numbers) or min(numbers[1:]) <= -1.0:
        raise ValueError(f"calibration: {numbers} are not the errors of a camera")
    return CameraCalibration(numbers[0], _read_pose(entry["nominal_from_true"]), *numbers[1:])


def _vector(values: Any) -> FloatArray:
    vector = np.array(values, dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"motion {values!r} is not three numbers")
    return vector


def _pose(pose: Pose) -> dict[str, list[float]]:
    return {"quat_wxyz": pose.quat_wxyz.tolist(), "translation_m": pose.translation_m.tolist()}


def _read_pose(entry: dict[str, list[float]]) -> Pose:
    return Pose(np.array(entry["quat_wxyz"]), np.array(entry["translation_m"]))
