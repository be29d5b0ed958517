"""Playback of the keyframes of a flight folder as a camera and a pose source, in real time.

Reads keyframes/poses.json (intrinsics and the pose of the depth imager, for every keyframe), NNNN_rgb.jpg and NNNN_depth.png
(16 bit, millimetres as the camera reported them, 0 = no return), as mapping/keyframe_store.py writes them. Depth is divided by
1 + depth_scale, which the keyframe was corrected for.
"""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from uav_recon.interfaces import Clock
from uav_recon.sensors.recordings.frame_stamps import require_increasing
from uav_recon.sensors.recordings.image_decoding import read_depth, read_rgb
from uav_recon.sensors.recordings.recording import DamagedItemError, RecordingError
from uav_recon.sensors.stream_camera import depth_lookup_table
from uav_recon.types.camera import Frame, ImuSample, Intrinsics
from uav_recon.types.frames import Float32Array
from uav_recon.types.pose import Pose, StampedPose

_POSE_RATE_HZ = 15.0


@dataclass(frozen=True)
class Keyframe:
    """A keyframe of poses.json; its images are not read yet."""

    sequence: int
    stamp_s: float
    depth: Path
    depth_intrinsics: Intrinsics
    rgb: Path
    rgb_intrinsics: Intrinsics
    rgb_from_depth: Pose
    world_from_depth: Pose
    depth_scale: float

    @staticmethod
    def read(folder: Path, entry: dict[str, Any]) -> Keyframe:
        """Read an entry of the list. Raises ValueError, KeyError or TypeError."""
        depth, rgb = (Intrinsics.from_tree(entry[lens]) for lens in ("depth_intrinsics", "rgb_intrinsics"))
        files = [folder / Path(entry[name]).name for name in ("depth", "rgb")]  # never outside the folder
        rgb_from_depth, world_from_depth = (_pose(entry[name]) for name in ("rgb_from_depth", "world_from_depth"))
        sequence, stamp_s, scale = int(entry["sequence"]), float(entry["stamp_s"]), _depth_scale(entry)
        return Keyframe(sequence, stamp_s, files[0], depth, files[1], rgb, rgb_from_depth, world_from_depth, scale)

    def load(self, table: Float32Array, stamp_s: float) -> Frame:
        """Read the images (about 5 ms).

        Raises DamagedItemError if one is missing, damaged or of another size.

        table: metres of 16-bit depth.
        """
        depth_mm, image = read_depth(self.depth), read_rgb(self.rgb)
        depth, rgb = self.depth_intrinsics, self.rgb_intrinsics
        for path, pixels, lens in ((self.depth, depth_mm, depth), (self.rgb, image, rgb)):
            if pixels.shape[:2] != (lens.height, lens.width):
                raise DamagedItemError(f"{path}: is {pixels.shape[1]} x {pixels.shape[0]}; want {lens.width} x {lens.height}")
        true_m = table[depth_mm] / np.float32(1.0 + self.depth_scale)
        return Frame(stamp_s, self.sequence, true_m, depth, image, rgb, self.rgb_from_depth)


def _depth_scale(entry: dict[str, Any]) -> float:
    """Return the share by which depth is too large. Raises ValueError, KeyError or TypeError."""
    scale = float(entry["calibration"]["depth_scale"]) if "calibration" in entry else 0.0
    if not -1.0 < scale < math.inf:
        raise ValueError(f"depth_scale {scale:g}: want more than -1")
    return scale


def read_keyframes(folder: Path) -> list[Keyframe]:
    """Return the keyframes with a pose of a flight folder, or of its folder of keyframes.

    Raises RecordingError (one line) for a list that cannot be read, that is empty, or whose stamps do not increase.
    """
    images = folder / "keyframes" if (folder / "keyframes").is_dir() else folder
    path = images / "poses.json"
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
        frames = [Keyframe.read(images, entry) for entry in tree["keyframes"] if entry["world_from_depth"] is not None]
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror})") from None
    except json.JSONDecodeError as error:
        raise RecordingError(f"{path}: is no JSON from line {error.lineno}, column {error.colno} on; was it cut?") from None
    except KeyError as error:
        raise RecordingError(f"{path}: not a keyframe list: {error} is missing") from None
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        raise RecordingError(f"{path}: not a keyframe list: {' '.join(str(error).split())}") from None
    if not frames or any(not a.stamp_s < b.stamp_s for a, b in itertools.pairwise(frames)):
        raise RecordingError(f"{path}: wants at least one keyframe, with stamps that increase")
    require_increasing(path, [frame.stamp_s for frame in frames])
    return frames


class _Recording:
    """Content of poses.json and the start time of the playback.

    The first keyframe is due at once.
    """

    def __init__(self, folder: Path, clock: Clock) -> None:
        self.frames = read_keyframes(folder)
        self.shift_s = clock.now_s() - self.frames[0].stamp_s  # recorded stamp + shift = stamp on our clock


class RecordedCamera:
    """Camera protocol over a flight folder.

    Raises RecordingError (one line) if the folder cannot be played. missing_images counts keyframes whose images are missing
    or have another size; they are skipped.
    """

    def __init__(self, folder: Path, clock: Clock, depth_min_m: float = 0.3, depth_max_m: float = 6.0) -> None:
        self._recording = _Recording(folder, clock)
        self._clock = clock
        self._table = depth_lookup_table(depth_min_m, depth_max_m)
        self._next = 0
        self.missing_images = 0

    def poll(self) -> Frame | None:
        """Return the newest keyframe that is due, once, else None; reads two images (about 5 ms)."""
        recording, now_s = self._recording, self._clock.now_s()
        due = self._next
        while due < len(recording.frames) and recording.frames[due].stamp_s + recording.shift_s <= now_s + 1e-9:
            due += 1
        if due == self._next:
            return None
        self._next = due
        keyframe = recording.frames[due - 1]
        try:
            return keyframe.load(self._table, keyframe.stamp_s + recording.shift_s)
        except DamagedItemError:
            self.missing_images += 1
            return None

    def imu(self) -> list[ImuSample]:
        """Return an empty list: keyframes have no inertial samples."""
        return []

    def close(self) -> None:
        """Do nothing: no resource is open."""


class RecordedPoses:
    """PoseSource protocol over the same folder: keyframe poses, linearly interpolated at 15 Hz.

    body_from_depth: mount of the depth imager on the body (fixed).
    """

    def __init__(self, folder: Path, clock: Clock, body_from_depth: Pose) -> None:
        self._recording = _Recording(folder, clock)
        self._clock = clock
        self._depth_from_body = body_from_depth.inverse()
        first, last = self._recording.frames[0].stamp_s, self._recording.frames[-1].stamp_s
        grid = first + np.arange(math.floor((last - first) * _POSE_RATE_HZ) + 1) / _POSE_RATE_HZ
        own = np.array([frame.stamp_s for frame in self._recording.frames])
        apart = np.abs(grid[:, None] - own).min(axis=1) > 0.5 / _POSE_RATE_HZ  # every keyframe has its exact pose
        self._stamps_s = np.sort(np.concatenate((grid[apart], own)))
        self._next = 0

    def poses(self) -> list[StampedPose]:
        """Return the poses that became due since the last call."""
        now_s = self._clock.now_s() - self._recording.shift_s
        due = int(np.searchsorted(self._stamps_s, now_s + 1e-9, side="right"))
        out = [self._pose_at(float(stamp_s)) for stamp_s in self._stamps_s[self._next : due]]
        self._next = max(self._next, due)
        return out

    def _pose_at(self, stamp_s: float) -> StampedPose:
        frames = self._recording.frames
        after = next((i for i, frame in enumerate(frames) if frame.stamp_s >= stamp_s), len(frames) - 1)
        a, b = frames[max(after - 1, 0)], frames[after]
        share = (stamp_s - a.stamp_s) / (b.stamp_s - a.stamp_s) if b.stamp_s > a.stamp_s else 0.0
        qa, qb = a.world_from_depth.quat_wxyz, b.world_from_depth.quat_wxyz
        quat = (1 - share) * qa + share * (qb if qa @ qb >= 0 else -qb)
        position = (1 - share) * a.world_from_depth.translation_m + share * b.world_from_depth.translation_m
        world_from_depth = Pose(quat, position)
        return StampedPose(stamp_s + self._recording.shift_s, world_from_depth @ self._depth_from_body, np.zeros(3))


def _pose(tree: Any) -> Pose:
    return Pose(np.array(tree["quat_wxyz"], dtype=np.float64), np.array(tree["translation_m"], dtype=np.float64))
