"""The pilot's state at an instant, as input for the guard, the failsafe and the mission."""

from __future__ import annotations

import math

import numpy as np

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.parameters.preflight_check import NoParameterCheck, ParameterCheck
from uav_recon.autopilot.pilot.setpoints.setpoint_selection import SetpointSelector
from uav_recon.autopilot.pilot.situation.estimate_monitor import EstimateMonitor
from uav_recon.autopilot.pilot.situation.mission_input import MissionInput
from uav_recon.autopilot.pilot.situation.pose_feed import PoseFeed
from uav_recon.autopilot.pilot.situation.surroundings import Surroundings
from uav_recon.safety.envelope import Vec3
from uav_recon.safety.failsafe_precedence import FailsafeInputs
from uav_recon.safety.guard import Guard, GuardInputs
from uav_recon.safety.refusals import RefusalHistory
from uav_recon.types.pose import Pose, PoseHealth
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import FlightPhase, VehicleState

_ODOMETRY_DEGRADED = Reason(ReasonCode.ODOMETRY_DEGRADED)
_LONGEST_NOTE = 200  #: internal: characters of a message; a longer one is reported without its details


class SituationBuilder:
    """Builds the inputs from the pilot's parts at each call; stores nothing itself."""

    def __init__(
        self,
        link: VehicleLink,
        guard: Guard,
        poses: PoseFeed,
        mandate: MissionInput,
        lookout: Surroundings,
        steering: SetpointSelector,
        parameters: ParameterCheck | NoParameterCheck,
        estimate: EstimateMonitor,
    ) -> None:
        self._link = link
        self._guard = guard
        self._poses = poses
        self._parameters = parameters
        self._mandate = mandate
        self._lookout = lookout
        self._steering = steering
        self._estimate = estimate

    def situation(self, now_s: float) -> GuardInputs:
        """Return the guard's inputs.

        Without a pose the position is odom's origin, with an infinite pose age.
        """
        pose, intent_age_s = self._poses.pose, self._mandate.age_s(now_s)
        free, ahead = self._lookout.known_free, self._lookout.ahead
        if pose is None:
            return GuardInputs(now_s, self._position_m, 0.0, np.eye(3), math.inf, intent_age_s, 0, free, ahead)
        body_from_odom, yaw_rad = pose.odom_from_body.rotation().T, pose.odom_from_body.yaw_rad()
        age_s = now_s - pose.stamp_s
        slow = pose.health is not PoseHealth.GOOD or self._link.status.slow is not None
        return GuardInputs(
            now_s, self._position_m, yaw_rad, body_from_odom, age_s, intent_age_s, pose.map_epoch, free, ahead, slow
        )

    def health(self, now_s: float, refusals: RefusalHistory) -> FailsafeInputs:
        """Return the failsafe's inputs. refusals: of this flight."""
        inside = self._guard.envelope.fence.holds(self._position_m)
        pose_s = min(self._poses.sound_s, self._link.status.pose_fed_s)  # no other poses are used for flight
        lost = (
            self._link.status.duplicate_fault
            or self._parameters.changed(self._link)
            or self._poses.lost
            or self._estimate.hold_reason
        )
        wrong = self._poses.wrong or self._estimate.land_reason
        ages_s = (now_s - pose_s, self._mandate.age_s(now_s), self._lookout.depth_age_s(now_s))
        rejected = self._lookout.rejects_depth(now_s, self._guard.bounds.depth_timeout_s)
        unsure = self._poses.unsure if self._steering.has_climbed else None
        many = refusals.many(now_s)
        return FailsafeInputs(now_s, *ages_s, inside, many, lost, wrong, refusals.refused_s, rejected, unsure)

    def state(self, now_s: float, phase: FlightPhase, note: Reason | None, operator_s: float, gimbal: bool) -> VehicleState:
        """Return the state for the mission, with the autopilot's own pose before there is odometry.

        operator_s: time of the last operator heartbeat. gimbal: True if the gimbal pitch is valid.
        """
        t, pose, trajectory = self._link.telemetry, self._poses.pose, self._mandate.trajectory
        if pose is not None:
            world_from_body, velocity = pose.odom_from_body, pose.velocity_odom_mps
        else:
            world_from_body, velocity = Pose(t.estimate.quat_wxyz, t.estimate.position_m), t.estimate.velocity_mps
        return VehicleState(
            stamp_s=now_s,
            world_from_body=world_from_body,
            velocity_world_mps=velocity,
            armed=t.mode.armed,
            mode=self._link.firmware.mode_name(t.mode.custom_mode) if math.isfinite(t.mode.heartbeat_s) else "",
            phase=phase,
            battery_fraction=t.battery.fraction_at(now_s),
            human_in_control=phase is FlightPhase.YIELDED,
            camera_pitch_down_rad=t.camera_pitch_down_rad if gimbal else math.nan,
            trajectory_id=-1 if trajectory is None else trajectory.identifier,
            refusals=self._guard.refusals.total,
            note=_shortened(note),
            operator_received_s=operator_s,
            max_speed_mps=math.inf if self.slow_reason is None else self._guard.bounds.retreat_speed_mps,
            world_from_rest=self._steering.odom_from_rest,
            slow_reason=self.slow_reason,
            camera_pitch_s=t.camera_pitch_s if gimbal else math.nan,
        )

    @property
    def slow_reason(self) -> Reason | None:
        """Reason why the speed is reduced, by the odometry or the link; None if it is not."""
        pose = self._poses.pose
        if pose is not None and pose.health is not PoseHealth.GOOD:
            return pose.health_reason or _ODOMETRY_DEGRADED
        return self._link.status.slow

    @property
    def _position_m(self) -> Vec3:
        """Position in odom; its origin before the first pose."""
        x, y, z = self._poses.pose.odom_from_body.translation_m.tolist() if self._poses.pose else (0.0, 0.0, 0.0)
        return x, y, z


def _shortened(note: Reason | None) -> Reason | None:
    """Return a reason as it is, or without its details where they say more than anybody reads."""
    return note if note is None or len(note.text()) <= _LONGEST_NOTE else Reason(note.code, note.values)
