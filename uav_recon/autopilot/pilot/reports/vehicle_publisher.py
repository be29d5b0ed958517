"""Vehicle publisher: state for the mission, the autopilot's measurements for perception."""

from __future__ import annotations

import math

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.pilot.pilot_channels import PilotChannels
from uav_recon.autopilot.pilot.setpoints.setpoint_selection import SetpointSelector
from uav_recon.autopilot.pilot.situation.situation import Situation
from uav_recon.types.pose import Pose
from uav_recon.types.reason import Reason
from uav_recon.types.vehicle import FlightPhase, VehicleState

_LONGEST_NOTE = 200  #: internal: characters of a message; a longer one is reported without its details


class VehiclePublisher:
    """Publishes what the other processes need to know of the vehicle.

    gimbal: True if the gimbal pitch is valid.
    """

    def __init__(
        self, channels: PilotChannels, link: VehicleLink, situation: Situation, selector: SetpointSelector, *, gimbal: bool
    ) -> None:
        self._vehicle = channels.vehicle
        self._rates = channels.rates
        self._reported = channels.reported
        self._flow = channels.flow
        self._link = link
        self._situation = situation
        self._selector = selector
        self._gimbal = gimbal

    def publish_measurements(self) -> None:
        """Publish the autopilot's turn rates, poses and optical flow at once.

        They are worth less with each millisecond.
        """
        rates, poses = self._link.measurements.turn_rates(), self._link.measurements.reported_poses()
        flow = self._link.flow.readings()
        if rates is not None:
            self._rates.publish(rates)
        if poses is not None:
            self._reported.publish(poses)
        if flow is not None:
            self._flow.publish(flow)

    def publish_state(self, now_s: float, phase: FlightPhase, note: Reason | None, operator_received_s: float) -> None:
        """Publish the state for the mission, with the autopilot's own pose before there is odometry.

        operator_received_s: time of the last operator heartbeat.
        """
        t, pose, trajectory = self._link.telemetry, self._situation.poses.pose, self._situation.mission.trajectory
        if pose is not None:
            world_from_body, velocity = pose.odom_from_body, pose.velocity_odom_mps
        else:
            world_from_body, velocity = Pose(t.estimate.quat_wxyz, t.estimate.position_m), t.estimate.velocity_mps
        state = VehicleState(
            stamp_s=now_s,
            world_from_body=world_from_body,
            velocity_world_mps=velocity,
            armed=t.mode.armed,
            mode=self._link.firmware.mode_name(t.mode.custom_mode) if math.isfinite(t.mode.heartbeat_s) else "",
            phase=phase,
            battery_fraction=t.battery.fraction_at(now_s),
            human_in_control=phase is FlightPhase.YIELDED,
            camera_pitch_down_rad=t.camera_pitch_down_rad if self._gimbal else math.nan,
            trajectory_id=-1 if trajectory is None else trajectory.identifier,
            refusals=self._selector.refusals,
            note=_shortened(note),
            operator_received_s=operator_received_s,
            max_speed_mps=self._situation.max_speed_mps,
            world_from_rest=self._selector.odom_from_rest,
            slow_reason=self._situation.slow_reason,
            camera_pitch_s=t.camera_pitch_s if self._gimbal else math.nan,
        )
        self._vehicle.publish(state)


def _shortened(note: Reason | None) -> Reason | None:
    """Return a reason as it is, or without its details where they say more than anybody reads."""
    return note if note is None or len(note.text()) <= _LONGEST_NOTE else Reason(note.code, note.values)
