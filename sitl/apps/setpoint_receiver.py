"""Receiver for `uav-recon bench setpoints`: simulated autopilot, and inputs for a hover.

Run as a process: `python -m sitl.apps.setpoint_receiver CONFIG SECONDS AUTOPILOT OUT`. SECONDS after the first setpoint in
flight it writes OUT (arrivals_s, begin_s, end_s; kernel receive times). Exit code 1: the vehicle did not fly.
"""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path

import numpy as np

from sitl.apps.world_process import STEP_S
from sitl.autopilots.ardupilot.autopilot import ArduCopter
from sitl.autopilots.ardupilot.parameters import ArduPilotParameters
from sitl.autopilots.base_autopilot import Autopilot
from sitl.autopilots.byte_links import ByteEnd, UdpPeer
from sitl.autopilots.px4.autopilot import Px4
from sitl.autopilots.px4.parameters import Px4Parameters
from sitl.world.quadrotor import Quadrotor
from uav_recon import config as configuration
from uav_recon.app import mission_factory
from uav_recon.app.flight_channels import file_channels
from uav_recon.clock import RateKeeper
from uav_recon.config import Config
from uav_recon.types.camera import body_from_camera
from uav_recon.types.maps import FreeSpace, GridSpec
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.trajectory import Goal, Intent, Setpoint, Trajectory
from uav_recon.types.vehicle import FlightPhase

GIVE_UP_S = 180.0  # timeout for the first setpoint in flight
SETTLE_S = 1.0  # from the first setpoint in flight to the start of the measurement
_POSES_HZ = 30.0
_DEPTH_HZ = 15.0
_INTENT_HZ = 20.0


class Hover:
    """Outputs of perception and mission for a hover at take-off height in an empty hall."""

    def __init__(self, config: Config, autopilot: Autopilot, start_s: float) -> None:
        self._config = config
        self._autopilot = autopilot
        self._channels = file_channels(config.runtime.folder, frozenset({"odom", "nearby", "intent", "free"}))
        self._motion = mission_factory.make_motion(config, config.planner.clearance_m)
        self._motion.warm_up()
        self._poses, self._depth, self._intents = (RateKeeper(hz, start_s) for hz in (_POSES_HZ, _DEPTH_HZ, _INTENT_HZ))
        self._ranges = np.full((12, 16), 9.0, dtype=np.float32)
        self._body_from_depth = body_from_camera(np.array(config.camera.position_body_m), math.radians(15.0))
        self._intent: tuple[Goal, Trajectory | None] = (Goal.STANDBY, None)
        safety = config.safety
        grid = GridSpec.covering(np.array(safety.fence_min_m), np.array(safety.fence_max_m), 0.1)
        self._channels.free.publish(FreeSpace(grid, np.packbits(np.ones(grid.shape, dtype=np.bool_)), 1))

    def step(self, now_s: float) -> None:
        """Publish poses, depth and intents that are due."""
        truth = self._autopilot.truth()
        if self._poses.due(now_s):
            pose = Pose(np.array(truth.quat_wxyz), np.array(truth.position))
            self._channels.odom.publish(StampedPose(truth.stamp_s, pose, np.array(truth.velocity)))
        if self._depth.due(now_s):
            self._channels.nearby.publish(MinRangeGrid(now_s, self._body_from_depth, self._ranges, (0.95, 0.55), 0.9))
        if self._intents.due(now_s):
            self._channels.intent.publish(self._wanted(now_s))

    def _wanted(self, now_s: float) -> Intent:
        vehicle = self._channels.vehicle.latest()
        phase = FlightPhase.CONNECTING if vehicle is None else vehicle.phase
        goal, trajectory = self._intent
        if phase is FlightPhase.READY:
            goal = Goal.FLY
        elif phase is FlightPhase.FLYING and trajectory is None:
            up = np.array([0.0, 0.0, self._config.mission.takeoff_height_m])
            trajectory = self._motion.plan_line(Setpoint.hold(np.zeros(3), 0.0), up, 0.0, now_s + 0.3, 1)
        self._intent = (goal, trajectory)
        return Intent(now_s, *self._intent)


def receive(config: Config, seconds: float, name: str, out: Path) -> int:
    """Fly, and write the arrival times of the setpoints to out; return the exit code."""
    link = UdpPeer(remote=("127.0.0.1", int(config.link.url.rpartition(":")[2])))
    autopilot = _autopilot(name, link)
    hover, start_s = Hover(config, autopilot, time.monotonic()), time.monotonic()
    begin_s, next_s = math.inf, start_s
    while (now_s := time.monotonic()) < begin_s + seconds:
        autopilot.step(now_s)
        hover.step(now_s)
        if begin_s == math.inf and autopilot.setpoint_arrivals_s:
            begin_s = now_s + SETTLE_S
        if begin_s == math.inf and now_s - start_s > GIVE_UP_S:
            return 1
        next_s = max(next_s + STEP_S, now_s)
        time.sleep(max(next_s - time.monotonic(), 0.0))
    np.savez(out, arrivals_s=np.array(autopilot.setpoint_arrivals_s), begin_s=begin_s, end_s=begin_s + seconds)
    return 0


def _autopilot(name: str, link: ByteEnd) -> Autopilot:
    if name == "ardupilot":
        return ArduCopter(Quadrotor(1, 0.0), link, ArduPilotParameters.load(), 1)
    return Px4(Quadrotor(1, 0.0), link, Px4Parameters.load(), 1)


if __name__ == "__main__":
    sys.exit(receive(configuration.load(Path(sys.argv[1])), float(sys.argv[2]), sys.argv[3], Path(sys.argv[4])))
