"""Take-off: first a small lift off the floor, then the climb to the flight height."""

from __future__ import annotations

import numpy as np

from uav_recon.interfaces import MotionPlannerInterface
from uav_recon.mission.trajectory.trajectory_execution import TrajectoryExecutor
from uav_recon.types.vehicle import FlightPhase, VehicleState

LIFT_M = 0.3  #: plan: height of the first climb: the setpoint must not climb away from an autopilot that ramps up its thrust
LIFTED_M = 0.2  #: plan: below it the vehicle is not off the floor, and does not climb on to the flight height


class Takeoff:
    """Climbs in two steps.

    The setpoint must not climb away from an autopilot that still ramps up its thrust.

    height_m: over the pad's zero.
    """

    def __init__(self, executor: TrajectoryExecutor, motion: MotionPlannerInterface, height_m: float) -> None:
        self._executor = executor
        self._motion = motion
        self._height_m = height_m
        self.begun_s = np.inf
        self.risen = False  # off the floor, and the climb to the flight height is commanded

    def begin_again(self) -> None:
        """Restart from the present position."""
        self._executor.track.trajectory = None
        self.risen = False

    def step(self, now_s: float, vehicle: VehicleState) -> None:
        """Command the next part of the climb at rest, once the vehicle flies."""
        track = self._executor.track
        resting = track.trajectory is None or self._executor.at_rest(now_s)
        if not resting or self.risen or vehicle.phase is not FlightPhase.FLYING:
            return
        start = track.end_setpoint(vehicle)
        self.risen = bool(start.position_m[2] >= LIFTED_M)
        goal = np.array([*start.position_m[:2], self._height_m if self.risen else LIFT_M])
        self.begun_s = min(self.begun_s, now_s)
        self._executor.fly(self._motion.plan_line(start, goal, start.yaw_rad, now_s, track.next_identifier()), now_s)
