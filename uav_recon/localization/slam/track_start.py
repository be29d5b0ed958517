"""Start of a track: at rest or in motion.

At rest, inertial samples show where down is. In motion, it is where other odometry is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from uav_recon.localization.slam.floor_level import level_by_floor
from uav_recon.localization.slam.rest_detection import RestDetector
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, StampedPose

# a body that rests has moved if this much of a view says so
_REST_M = 0.01
_SEEN_POINTS = 200
_SEEN_LANDMARKS = 15
_LATE_SENSOR_S = 3.0  # after a start without inertial samples, in which the first ones may come and the body be levelled again

OdomAt = Callable[[float], StampedPose | None]  # odometry at an instant, None if it is not known


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """Inertial sensors at rest.

    gyro_bias_radps (3,). force_offset_mps2 (3,): what the accelerometer measures beside gravity.
    """

    gyro_bias_radps: FloatArray
    force_offset_mps2: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Start of a track.

    velocity_mps (3,): in odom. rest: what the rest shows; None in motion: what is known of the sensors stays.
    """

    odom_from_body: Pose
    velocity_mps: FloatArray
    rest: Rest | None


class StartDetector:
    """Finds where a track begins, and when a body at rest is launched. Not thread-safe.

    ``launches``: the newest frame is the first one that is not of the rest; it may have moved for up to STILL_S.
    """

    def __init__(self) -> None:
        self._rest = RestDetector()
        self._odom_at: OdomAt | None = None
        self._level_assumed_s = -math.inf  # start without inertial samples
        self._launched = False  # inertial samples or images have shown that the body has moved once
        self.launches = False

    def add_imu(self, samples: list[ImuSample]) -> None:
        """Add inertial samples, oldest first."""
        self._rest.add(samples)

    def begin_at(self, odom_at: OdomAt) -> None:
        """Let the next track begin in motion, where other odometry is by then."""
        self._odom_at = odom_at

    def start(self, frame: Frame, delay_s: float, body_from_depth: Pose) -> Start | None:
        """Return where a track begins at a frame; None while it is not known.

        delay_s: time from what the frame shows to its stamp.
        """
        if self._odom_at is not None:
            return self._start_moving(self._odom_at(frame.stamp_s - delay_s))
        level = self._rest.level(frame.stamp_s)
        if level is None:
            return None
        self._level_assumed_s = -math.inf if self._rest.measured else frame.stamp_s
        self._launched = False
        level = level_by_floor(frame, level, body_from_depth)
        return Start(level, np.zeros(3), Rest(self._rest.gyro_bias_radps, self._rest.force_offset_mps2(level)))

    def _start_moving(self, odom: StampedPose | None) -> Start | None:
        if odom is None:
            return None
        self._odom_at, self._launched = None, True
        return Start(odom.odom_from_body, odom.velocity_odom_mps, None)

    def starts_again(self, stamp_s: float, place_m: FloatArray) -> bool:
        """Return True if the first inertial samples show the rest after a start without them.

        An inertial sensor may start later than the camera; the body was taken as level until then. place_m (3,): of the body.
        """
        late = 0.0 < stamp_s - self._level_assumed_s < _LATE_SENSOR_S and self._rest.measured
        return late and float(np.linalg.norm(place_m)) < _REST_M and self._rest.level(stamp_s) is not None

    def still(self, stamp_s: float) -> bool:
        """Return True before the launch while inertial samples show rest."""
        return not self._launched and self._rest.still(stamp_s)

    def rests(self, stamp_s: float, known_points: float, landmarks: int, moved_m: float) -> bool:
        """Return True until inertial samples or an image show that the body has moved once.

        known_points, landmarks: that show in the image that the body has moved by moved_m.
        """
        seen = known_points >= _SEEN_POINTS or landmarks >= _SEEN_LANDMARKS
        before = self._launched
        self._launched = self._launched or not self._rest.still(stamp_s) or (seen and moved_m > _REST_M)
        self.launches = self._launched and not before
        return not self._launched
