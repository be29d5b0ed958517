"""Upward range finder: turns the autopilot's readings into free cones in odom."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.mavlink.messages import UpwardRange
from uav_recon.autopilot.mavlink.telemetry import RangeReport
from uav_recon.autopilot.pilot.situation.recent_poses import RecentPoses
from uav_recon.interfaces import Channel
from uav_recon.safety.recently_seen_space import RecentlySeenSpace
from uav_recon.types.frames import FloatArray
from uav_recon.types.free_cone import FreeCone
from uav_recon.types.pose import PoseHealth, StampedPose

STREAM = (132, 15.0)  # DISTANCE_SENSOR and its rate in Hz, to be requested
_BESIDE_S = 0.03  #: reject: a reading of the upward range finder farther in time from every pose
_WAIT_S = 0.2  #: reject: a reading of the upward range finder without a later pose after this time
_MAX_TILT_DEG = 10.0  #: reject: a reading of the upward range finder while the body leans more than this
#: reject: what the upward range finder sees nearer to the side of its cone: errors of its mount and of the attitude
_AIM_DEG = 2.0
#: reject: what the upward range finder sees free nearer to its reading, at the speed of flight: ArduPilot sends it again as new
_LATE_S = 0.1
_ERROR_SIGMAS = 3.0  #: reject: what the upward range finder sees free nearer to its reading, in errors of the sensor
#: reject: a reading of the upward range finder that equals as many before it: a frozen one frees no voxel, as that takes four
_MAX_EQUAL = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class RangeFinderModel:
    """The sensor as the operator declares it.

    fov_rad: whole angle of its cone. position_body_m: (3,). error_share: rms error as a share of the range.
    """

    fov_rad: float
    position_body_m: FloatArray
    error_share: float


class NoRangeFinder:
    """In place of a range finder, on a vehicle without one."""

    def step(self, pose: StampedPose | None, now_s: float) -> None:
        """Do nothing."""

    def forget(self) -> None:
        """Do nothing."""


class UpwardRangeFinder:
    """Publishes a cone for each valid reading, and gives it to the guard's memory.

    A reading waits for the first pose after it. It is used with the nearest one, if that is good and nearly level.
    """

    def __init__(
        self, model: RangeFinderModel, link: VehicleLink, seen_space: RecentlySeenSpace, cones: Channel[FreeCone]
    ) -> None:
        self._model = model
        self._link = link
        self._seen_space = seen_space
        self._cones = cones
        self._past = RecentPoses()
        self._newest: UpwardRange | None = None
        self._waiting: RangeReport | None = None
        self._equal = 0  # readings in a row that equal the newest one

    def step(self, pose: StampedPose | None, now_s: float) -> None:
        """Process a new reading. Raises nothing: one that cannot be used is ignored."""
        self._past.add(pose, now_s)
        report = self._link.telemetry.range_up
        if report is not None and self._is_new(report.reading) and not self._link.status.duplicate_autopilot:
            self._waiting = report
        waiting = self._waiting
        if waiting is None or self._past.newest_s < waiting.measured_s:
            return
        self._waiting = None
        cone = self._cone(waiting) if now_s - waiting.measured_s <= _WAIT_S else None
        if cone is not None:
            self._seen_space.add_cone(cone)
            self._cones.publish(cone)

    def forget(self) -> None:
        """Forget poses and readings after a jump of odom."""
        self._past.forget()
        self._waiting = None

    def _is_new(self, reading: UpwardRange) -> bool:
        """Return True for a new measurement of the first sensor that was received.

        It is none if it repeats a stamp, or if the readings no longer change.
        """
        before = self._newest
        if before is not None and (reading.sensor != before.sensor or reading.boot_ms == before.boot_ms):
            return False
        self._newest = reading
        self._equal = self._equal + 1 if before is not None and reading.range_m == before.range_m else 1
        return self._equal <= _MAX_EQUAL

    def _cone(self, report: RangeReport) -> FreeCone | None:
        """Return what a reading says is free, None if its pose is not good or nothing is left."""
        model, reading = self._model, report.reading
        then = self._past.at(report.measured_s, _BESIDE_S)
        if then is None or then.health is not PoseHealth.GOOD:
            return None
        axis = then.odom_from_body.rotation()[:, 2]
        half_rad = min(model.fov_rad, reading.fov_rad) / 2.0 - math.radians(_AIM_DEG)
        moved_m = _LATE_S * float(np.linalg.norm(then.velocity_odom_mps))
        reach_m = reading.range_m * (1.0 - _ERROR_SIGMAS * model.error_share) - moved_m
        if axis[2] < math.cos(math.radians(_MAX_TILT_DEG)) or half_rad <= 0.0 or reach_m <= 0.0:
            return None
        apex_m = then.odom_from_body.apply(np.asarray(model.position_body_m))
        return FreeCone(report.measured_s, then.map_epoch, apex_m, axis, half_rad, reach_m)
