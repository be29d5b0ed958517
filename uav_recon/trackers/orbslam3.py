"""ORB-SLAM3 by the wheel orbslam3-python (GPL-3.0), which no process of the flight imports.

Vocabulary: ORBvoc.txt of ORB-SLAM3, by its path.
"""

from __future__ import annotations

import importlib
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from uav_recon.trackers.engine import RgbdView, TrackedPose, TrackerError
from uav_recon.types.camera import Intrinsics
from uav_recon.types.pose import Pose

_INSTALL = "pip install --no-deps orbslam3-python"
_MOST_FEATURES = 1000  # for 640 x 480
_GOOD_FEATURES = 100  # matched, for a quality of 100
_SETTINGS = """%YAML:1.0
File.version: "1.0"
Camera.type: "PinHole"
Camera1.fx: {fx:.6f}
Camera1.fy: {fy:.6f}
Camera1.cx: {cx:.6f}
Camera1.cy: {cy:.6f}
Camera1.k1: 0.0
Camera1.k2: 0.0
Camera1.p1: 0.0
Camera1.p2: 0.0
Camera.width: {width}
Camera.height: {height}
Camera.newWidth: {width}
Camera.newHeight: {height}
Camera.fps: 15
Camera.RGB: 1
Stereo.ThDepth: 80.0
Stereo.b: 0.05
RGBD.DepthMapFactor: 1.0
ORBextractor.nFeatures: {features}
ORBextractor.scaleFactor: 1.2
ORBextractor.nLevels: 8
ORBextractor.iniThFAST: 20
ORBextractor.minThFAST: 7
Viewer.KeyFrameSize: 0.05
Viewer.KeyFrameLineWidth: 1.0
Viewer.GraphLineWidth: 1.0
Viewer.PointSize: 2.0
Viewer.CameraSize: 0.08
Viewer.CameraLineWidth: 3.0
Viewer.ViewpointX: 0.0
Viewer.ViewpointY: -0.7
Viewer.ViewpointZ: -3.5
Viewer.ViewpointF: 500.0
"""


def check_vocabulary(path: Path) -> None:
    """Check the first and the last line of a vocabulary. Raises TrackerError.

    The engine itself ends the process, or reads on, with a wrong file.
    """
    try:
        with path.open("rb") as file:
            head = file.readline(200).split()
            first = file.readline(400).split()
            file.seek(max(path.stat().st_size - 400, 0))
            last = file.read().splitlines()[-1].split()
    except OSError as error:
        raise TrackerError(f"{path}: cannot be read ({error.strerror})") from None
    except IndexError:
        raise TrackerError(f"{path}: empty") from None
    numbers = _numbers(head)
    if len(numbers) != 4 or not (2 <= numbers[0] <= 20 and 1 <= numbers[1] <= 10):
        raise TrackerError(f"{path}: not an ORB vocabulary as text (want ORBvoc.txt, unpacked)")
    if len(_numbers(first)) != _NODE or len(_numbers(last)) != _NODE:
        raise TrackerError(f"{path}: truncated ORB vocabulary")


_NODE = 35  # parent, leaf or not, 32 bytes of the descriptor, weight


def _numbers(words: list[bytes]) -> list[float]:
    try:
        return [float(word) for word in words]
    except ValueError:
        return []


class OrbSlam3:
    """TrackingEngine protocol over ORB-SLAM3 in its RGB-D mode.

    Loop closures move the world: a pose may then jump. Raises TrackerError if the wheel or the vocabulary is missing.
    """

    def __init__(self, vocabulary: Path, camera: Intrinsics) -> None:
        check_vocabulary(vocabulary)
        try:
            self._engine: Any = importlib.import_module("orbslam3")
        except ImportError as error:
            raise TrackerError(f"orbslam3 cannot be imported ({error}): {_INSTALL}") from None
        with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
            file.write(settings(camera))
            file.flush()
            self._system = self._engine.System(str(vocabulary), file.name, self._engine.Sensor.RGBD)
            self._system.set_use_viewer(False)
            if not self._system.initialize():
                raise TrackerError("orbslam3: could not be initialised")
        self._world = 0
        self._begun = False

    def track(self, view: RgbdView) -> list[TrackedPose]:
        """Track a view. Empty while it is lost."""
        self._system.process_image_rgbd(np.ascontiguousarray(view.rgb), np.ascontiguousarray(view.depth_m), view.stamp_s)
        state, states = self._system.get_tracking_state(), self._engine.TrackingState
        if self._begun and state in (states.NO_IMAGES_YET, states.NOT_INITIALIZED):  # lost for long, it begins another map
            self._world, self._begun = self._world + 1, False
        if state != states.OK:
            return []
        rgb_from_world = np.asarray(self._system.get_frame_pose(), dtype=np.float64)
        if rgb_from_world.shape != (4, 4) or not np.isfinite(rgb_from_world).all():
            return []
        self._begun = True
        quality = round(100.0 * min(self._system.get_num_matched_features() / _GOOD_FEATURES, 1.0))
        return [TrackedPose(view.stamp_s, Pose.from_matrix(rgb_from_world).inverse(), max(quality, 1), self._world)]

    def close(self) -> None:
        """End the engine's threads."""
        self._system.shutdown()


def settings(camera: Intrinsics) -> str:
    """Return the settings of the engine for a camera without distortion."""
    features = max(round(_MOST_FEATURES * min(camera.width * camera.height / (640 * 480), 2.0)), 500)
    return _SETTINGS.format(
        fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy, width=camera.width, height=camera.height, features=features
    )
