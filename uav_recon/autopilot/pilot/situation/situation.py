"""The pilot's situation: poses, surroundings, the autopilot's estimate, and intent."""

from __future__ import annotations

import math

import numpy as np

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.pilot.hull_geometry import HullGeometry
from uav_recon.autopilot.pilot.pilot_channels import PilotChannels
from uav_recon.autopilot.pilot.situation.estimate_monitor import EstimateMonitor
from uav_recon.autopilot.pilot.situation.mission_input import MissionInput
from uav_recon.autopilot.pilot.situation.pose_feed import PoseFeed
from uav_recon.autopilot.pilot.situation.surroundings import Surroundings
from uav_recon.autopilot.pilot.situation.upward_range_finder import NoRangeFinder, RangeFinderModel, UpwardRangeFinder
from uav_recon.safety.envelope import Vec3
from uav_recon.safety.failsafe_precedence import FailsafeInputs
from uav_recon.safety.guard import Guard, GuardInputs
from uav_recon.safety.pose_gate import PoseGate
from uav_recon.safety.refusals import RefusalHistory
from uav_recon.types.pose import PoseHealth
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_ODOMETRY_DEGRADED = Reason(ReasonCode.ODOMETRY_DEGRADED)


class Situation:
    """The pilot's knowledge at an instant, as input for the guard and the failsafe.

    ``poses`` are fed to the autopilot as they are read. range_finder: one that looks up, None without it.
    """

    def __init__(
        self,
        link: VehicleLink,
        guard: Guard,
        channels: PilotChannels,
        hull: HullGeometry,
        range_finder: RangeFinderModel | None,
    ) -> None:
        self._link = link
        self._guard = guard
        self._range_finder = (
            NoRangeFinder() if range_finder is None else UpwardRangeFinder(range_finder, link, guard.seen_space, channels.cones)
        )
        self.poses = PoseFeed(channels.odom, link, PoseGate(guard.envelope.max_yaw_rate_radps))
        self.surroundings = Surroundings(channels.free, channels.nearby, guard.seen_space, hull)
        self.estimate = EstimateMonitor(link)
        self.mission = MissionInput(channels.intent, guard.bounds.intent_timeout_s, guard.refusals)

    def read_pose(self, now_s: float) -> bool:
        """Read a new pose and feed it to the autopilot.

        Return True if it restarts odom: then call forget().
        """
        return self.poses.step(now_s)

    def forget(self) -> None:
        """Forget what was seen and compared before a restart of odom."""
        self.surroundings.forget()
        self._range_finder.forget()
        self.estimate.forget()

    def read_sensors(self, now_s: float) -> None:
        """Read the estimate, depth, free space and the range finder.

        Each is used with the pose at its stamp.
        """
        self.estimate.update(self.poses.pose, now_s)
        self.surroundings.step(self.poses.pose, now_s)
        self._range_finder.step(self.poses.pose, now_s)

    def guard_inputs(self, now_s: float) -> GuardInputs:
        """Return the guard's inputs.

        Without a pose the position is odom's origin, with an infinite pose age.
        """
        pose, intent_age_s = self.poses.pose, self.mission.age_s(now_s)
        free, ahead = self.surroundings.known_free, self.surroundings.ahead
        if pose is None:
            return GuardInputs(now_s, self._position_m, 0.0, np.eye(3), math.inf, intent_age_s, 0, free, ahead)
        body_from_odom, yaw_rad = pose.odom_from_body.rotation().T, pose.odom_from_body.yaw_rad()
        age_s = now_s - pose.stamp_s
        slow = pose.health is not PoseHealth.GOOD or self._link.status.slow is not None
        return GuardInputs(
            now_s, self._position_m, yaw_rad, body_from_odom, age_s, intent_age_s, pose.map_epoch, free, ahead, slow,
            self.surroundings.one_missing_s,
        )  # fmt: skip

    def failsafe_inputs(
        self, now_s: float, refusals: RefusalHistory, parameter_changed: Reason | None, *, has_views: bool
    ) -> FailsafeInputs:
        """Return the failsafe's inputs.

        refusals: of this flight. parameter_changed: what changed since arming. has_views: there are views to go back to.
        """
        inside = self._guard.envelope.fence.holds(self._position_m)
        pose_s = min(self.poses.sound_s, self._link.status.pose_fed_s)  # no other poses are used for flight
        unseen = self.poses.lost or self.poses.late  # the velocity is still known: to rest before it is not
        lost = self._link.status.duplicate_fault or parameter_changed or unseen or self.estimate.hold_reason
        wrong = self.poses.wrong or self.estimate.land_reason
        ages_s = (now_s - pose_s, self.mission.age_s(now_s), self.surroundings.depth_age_s(now_s))
        rejected = self.surroundings.rejects_depth(now_s, self._guard.bounds.depth_timeout_s)
        unsure = self.poses.unsure if has_views else None
        many = refusals.many(now_s)
        missing_s = self.surroundings.one_missing_s
        return FailsafeInputs(now_s, *ages_s, inside, many, lost, wrong, refusals.refused_s, rejected, unsure, missing_s)

    @property
    def slow_reason(self) -> Reason | None:
        """Reason why the speed is reduced, by the odometry or the link; None if it is not."""
        pose = self.poses.pose
        if pose is not None and pose.health is not PoseHealth.GOOD:
            return pose.health_reason or _ODOMETRY_DEGRADED
        return self._link.status.slow

    @property
    def max_speed_mps(self) -> float:
        """The guard's speed limit now, infinity if the speed is not reduced."""
        return math.inf if self.slow_reason is None else self._guard.bounds.retreat_speed_mps

    @property
    def _position_m(self) -> Vec3:
        """Position in odom; its origin before the first pose."""
        x, y, z = self.poses.pose.odom_from_body.translation_m.tolist() if self.poses.pose else (0.0, 0.0, 0.0)
        return x, y, z
