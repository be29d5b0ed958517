"""A lockstep flight without a mission: pilot and simulated autopilot over a pipe, poses straight from the truth."""

from __future__ import annotations

import itertools
from collections import Counter
from typing import Any

import numpy as np
from guard_rooms import TIMEOUTS
from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.base_autopilot import Autopilot
from sitl.autopilots.byte_links import ByteEnd, pipe
from sitl.autopilots.px4.autopilot import Px4
from sitl.autopilots.px4.parameters import Px4Parameters
from sitl.world.quadrotor import Quadrotor
from uav_recon.app.flight_channels import memory_channels
from uav_recon.autopilot.firmware.profile import FirmwareProfile
from uav_recon.autopilot.firmware.px4 import PX4
from uav_recon.autopilot.link.frame_exchange import FrameExchange
from uav_recon.autopilot.link.navigation import Navigation
from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.mavlink.allow_list import AllowListFilter
from uav_recon.autopilot.mavlink.tlog import FrameLog, NoLog
from uav_recon.autopilot.parameters.preflight_check import ParameterCheck
from uav_recon.autopilot.pilot.assembly import make_pilot
from uav_recon.autopilot.pilot.hull_geometry import HullGeometry
from uav_recon.autopilot.pilot.pilot import Pilot
from uav_recon.autopilot.pilot.sequence.preflight import Origin
from uav_recon.clock import ManualClock
from uav_recon.interfaces import ByteLink
from uav_recon.safety.envelope import Envelope, Fence
from uav_recon.safety.guard import Guard, GuardBounds
from uav_recon.safety.obstacle_speed_limit import Margins
from uav_recon.safety.recently_seen_space import RecentlySeenSpace
from uav_recon.types.camera import body_from_camera
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import FreeSpace, GridSpec
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.polygon import Polygon
from uav_recon.types.pose import Pose, PoseHealth, StampedPose
from uav_recon.types.reason import Reason, codes_in, codes_of
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal, Intent, Trajectory
from uav_recon.types.vehicle import FlightPhase, VehicleState

TICK_S = 0.01
POSES_DISAGREE = Reason(ReasonCode.POSES_DISAGREE, (0.3,))
TAKEOFF_LAG_S = 4.0  # PX4 spools up for 1 s and then ramps its take-off speed for 3 s: it arrives behind its setpoint
ENVELOPE = Envelope(
    fence=Fence(plan=Polygon.box((-3.0, -3.0), (5.0, 3.0)), floor_m=-0.2, ceiling_m=2.5, inset_m=0.3),
    max_speed_mps=1.0,
    max_acceleration_mps2=2.0,
    max_yaw_rate_radps=0.8,
)
BOUNDS = GuardBounds(
    pose_timeout_s=0.2,
    intent_timeout_s=0.5,
    silence_way_m=0.45,
    depth_timeout_s=0.3,
    blind_speed_mps=0.3,
    blind_fresh_s=3.0,
    blind_stale_s=10.0,
    retreat_speed_mps=0.3,
    margins=Margins(stop_clearance_m=0.1, fast_clearance_m=0.4),
)
HULL = HullGeometry(vehicle_radius_m=0.2, vehicle_height_m=0.2, hover_height_m=1.1)
GRID = GridSpec(np.array([-4.0, -4.0, -1.0]), 0.1, (100, 80, 40))
BODY_FROM_DEPTH = body_from_camera(np.array([0.1, 0.0, 0.0]), 0.26)
ORIGIN = Origin(47.3977, 8.5456, 488.0)
MODE, ARM = mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_CMD_COMPONENT_ARM_DISARM
SETPOINT = "SET_POSITION_TARGET_LOCAL_NED"


class Tap:
    """Sits between the pilot and the wire and keeps every message the pilot sent, with its time."""

    def __init__(self, inner: ByteLink, clock: ManualClock) -> None:
        self._inner = inner
        self._clock = clock
        self._parser = mavlink.MAVLink(None)
        self.sent: list[tuple[float, Any]] = []
        self.deaf = self.mute = False
        self.forged = b""  # of somebody else on the line, read once

    def read(self) -> bytes:
        data = self._inner.read() + self.forged
        self.forged = b""
        return b"" if self.deaf else data

    def write(self, data: bytes) -> None:
        for message in self._parser.parse_buffer(data) or []:
            self.sent.append((self._clock.now_s(), message))
        if not self.mute:
            self._inner.write(data)

    def wait(self, timeout_s: float) -> None:
        self._inner.wait(timeout_s)

    def close(self) -> None:
        self._inner.close()

    def since(self, instant_s: float) -> Counter[str]:
        """How many messages of each name were sent from an instant on; commands by name and number."""
        return Counter(self.name(message) for at, message in self.sent if at >= instant_s)

    @staticmethod
    def name(message: Any) -> str:
        kind = str(message.get_type())
        return f"{kind} {message.command}" if kind == "COMMAND_LONG" else kind


class Rig:
    """One flight. The test is the mission: it calls fly(), land() and silent()."""

    firmware: FirmwareProfile = PX4
    parameters: ParameterCheck | None = None

    def __init__(self, seed: int = 1, start: tuple[float, float, float] = (0.0, 0.0, 0.0), log: FrameLog | None = None) -> None:
        self.clock = ManualClock(100.0)
        ours, theirs = pipe()
        self.tap = Tap(ours, self.clock)
        self.vehicle = Quadrotor(seed, 0.1, start)
        self.autopilot = self._make_autopilot(theirs, seed)
        self.channels = memory_channels()
        self.free = np.ones(GRID.shape, dtype=np.bool_)
        self.publish_free()
        self.depth = True
        self.wall_m = 9.0  # what the camera sees, in every cell
        self.pilot = self.new_pilot(log)
        self.intent: tuple[Goal, Trajectory | None] | None = (Goal.STANDBY, None)
        self.said: Reason | None = None
        self.seeing_yaw_rad: float | None = None
        self.operator_lost = False
        self.poses = True
        self.health = PoseHealth.GOOD
        self.health_reason = POSES_DISAGREE  # of a health that is not good
        self.turn = 0
        self.track: list[tuple[float, FloatArray]] = []

    def _make_autopilot(self, end: ByteEnd, seed: int) -> Autopilot:
        return Px4(self.vehicle, end, Px4Parameters.load(), seed)

    @property
    def px4(self) -> Px4:
        """The autopilot, where it is PX4."""
        assert isinstance(self.autopilot, Px4)
        return self.autopilot

    def allow_list(self) -> AllowListFilter:
        """Whom the pilot hears."""
        return AllowListFilter()

    def navigation(self) -> Navigation | None:
        """Who tells the autopilot where it is; None: the poses are fed to it."""
        return None

    def new_pilot(self, log: FrameLog | None = None) -> Pilot:
        """As a process that starts now."""
        seen_space = RecentlySeenSpace(blind_memory_s=10.0, vehicle_radius_m=HULL.vehicle_radius_m)
        self.guard = Guard(ENVELOPE, BOUNDS, seen_space)
        return make_pilot(
            self.vehicle_link(log), self.guard, TIMEOUTS, self.channels, self.clock, ORIGIN, HULL, parameters=self.parameters
        )

    def vehicle_link(self, log: FrameLog | None) -> VehicleLink:
        """Return a new link of this flight's firmware, senders and navigation."""
        allow_list = self.allow_list()
        frames = FrameExchange(self.tap, log or NoLog(), allow_list.seal)
        return VehicleLink(frames, allow_list, self.firmware, self.clock.now_s(), self.navigation())

    def publish_free(self) -> None:
        """What the mission says is known free."""
        self.channels.free.publish(FreeSpace(GRID, np.packbits(self.free), 1))

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.step()

    def until(self, phase: FlightPhase, seconds: float) -> float:
        """Fly on until the pilot is in a phase; returns how long that took."""
        begin = self.clock.now_s()
        while self.pilot.phase is not phase:
            assert self.clock.now_s() - begin < seconds, f"{self.pilot.phase} after {seconds} s: {self.state.note}"
            self.step()
        return self.clock.now_s() - begin

    def step(self) -> None:
        now = 100.0 + self.turn * TICK_S
        self.clock.advance_to(now)
        self.autopilot.step(now)
        truth = self.autopilot.truth()
        if self.poses and self.turn % 3 == 0:
            pose = Pose(np.array(truth.quat_wxyz), np.array(truth.position))
            reason = None if self.health is PoseHealth.GOOD else self.health_reason
            velocity = np.array(truth.velocity)
            self.channels.odom.publish(StampedPose(truth.stamp_s, pose, velocity, health=self.health, health_reason=reason))
        if self.depth and self.turn % 7 == 0:
            ranges = np.full((12, 16), self.wall_m, dtype=np.float32)
            self.channels.nearby.publish(MinRangeGrid(now, BODY_FROM_DEPTH, ranges, (0.95, 0.55), 0.9))
        if self.intent is not None and self.turn % 5 == 0:
            self.channels.intent.publish(Intent(now, *self.intent, self.said, self.operator_lost, self.seeing_yaw_rad))
        self.pilot.step()
        self.track.append((now, np.array(truth.position)))
        self.turn += 1

    @property
    def state(self) -> VehicleState:
        state = self.channels.vehicle.latest()
        assert state is not None
        return state

    @property
    def note_codes(self) -> tuple[str, ...]:
        """Of the pilot's newest reason and its details."""
        return codes_of(self.state.note)

    def reported(self, since_s: float = 0.0) -> list[tuple[float, tuple[str, ...]]]:
        """Instants and codes of the STATUSTEXTs on the wire."""
        texts = [(at, str(m.text)) for at, m in self.tap.sent if at >= since_s and m.get_type() == "STATUSTEXT"]
        return [(at, codes_in(text)) for at, text in texts]

    @property
    def height_m(self) -> float:
        return float(self.autopilot.truth().position[2])

    def fly(self, *waypoints: tuple[float, float, float], identifier: int = 1) -> Trajectory:
        """Propose a smooth way from here through the points, at rest at each of them."""
        trajectory = smooth_way(self.clock.now_s() + 0.1, [self.autopilot.truth().position, *waypoints], identifier)
        self.intent = (Goal.FLY, trajectory)
        return trajectory

    def take_off_and_hover(self) -> None:
        """From boot to hovering at 1.1 m over the pad."""
        self.until(FlightPhase.READY, 20.0)
        self.intent = (Goal.FLY, None)
        self.until(FlightPhase.FLYING, 8.0)
        self.run(self.fly((0.0, 0.0, 1.1)).duration_s + TAKEOFF_LAG_S)
        assert abs(self.height_m - 1.1) < 0.05


def smooth_way(start_s: float, points: list[tuple[float, float, float]], identifier: int, mean_mps: float = 0.4) -> Trajectory:
    """Minimum-jerk legs: 10 s^3 - 15 s^4 + 6 s^5, sampled at 50 Hz."""
    step, parts = 0.02, []
    for a, b in itertools.pairwise(points):
        begin, way = np.array(a), np.array(b) - np.array(a)
        duration = max(float(np.linalg.norm(way)) / mean_mps, 1.0)
        s = np.arange(0.0, 1.0, step / duration)[:, None]
        parts.append(
            (
                begin + way * (10 * s**3 - 15 * s**4 + 6 * s**5),
                way * (30 * s**2 - 60 * s**3 + 30 * s**4) / duration,
                way * (60 * s - 180 * s**2 + 120 * s**3) / duration**2,
            )
        )
    still = np.zeros((1, 3))
    parts.append((np.array([points[-1]]), still, still))
    p, v, a3 = (np.vstack([part[i] for part in parts]) for i in range(3))
    flat = np.zeros(len(p))
    return Trajectory(start_s, step, p, v, a3, flat, flat, flat, np.zeros(0), 0, identifier)


def setpoints(rig: Rig, since_s: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Times (N,) and ENU places (N, 3) of the setpoints on the wire, turned by this test's own hand."""
    found = [(at, m) for at, m in rig.tap.sent if Tap.name(m) == SETPOINT and at >= since_s]
    return np.array([at for at, _ in found]), np.array([[m.y, m.x, -m.z] for _, m in found])
