"""A PX4-like autopilot with its vehicle."""

from __future__ import annotations

import math

from sitl.autopilots.base_autopilot import Autopilot
from sitl.autopilots.byte_links import ByteEnd
from sitl.autopilots.ekf import Estimator
from sitl.autopilots.mavlink_server import MavlinkServer
from sitl.autopilots.pilot_view import PilotView
from sitl.autopilots.px4.commander import Px4Commander, Px4Mode
from sitl.autopilots.px4.commands import Px4Commands
from sitl.autopilots.px4.flight_tasks import Px4FlightTasks
from sitl.autopilots.px4.messages import Px4Messages
from sitl.autopilots.px4.parameters import Px4Parameters
from sitl.autopilots.px4.state import Px4State
from sitl.autopilots.px4.timesync import Px4Timesync
from sitl.autopilots.px4.tuning import estimator_tuning
from sitl.geometry.quaternion import Vec3
from sitl.world.gimbal import Gimbal
from sitl.world.pose_tracker import PoseRecord
from sitl.world.quadrotor import Quadrotor
from sitl.world.step_sizes import FINE_STEPS

__all__ = ["BOOTED_BEFORE_S", "Px4"]

BOOTED_BEFORE_S = 37.5  # the autopilot's clock differs from the world clock, so stamps need TIMESYNC


class Px4(Autopilot):
    """The simulated PX4. Raises ValueError if a parameter's failsafe is not simulated."""

    def __init__(
        self, vehicle: Quadrotor, link: ByteEnd, parameters: Px4Parameters, seed: int, step_s: float = FINE_STEPS.physics_s
    ) -> None:
        """Create the autopilot. step_s: time step of physics, estimator and control, at most 20 ms."""
        self._parameters = parameters
        server = MavlinkServer(link, parameters)
        flight = Px4FlightTasks(parameters)
        estimator = Estimator(estimator_tuning(parameters), flight.estimate_jumped)
        commander = Px4Commander(parameters, seed + 1, server.say)
        half_range_rad = math.radians(parameters["MNT_RANGE_PITCH"]) / 2
        gimbal = Gimbal(-half_range_rad, half_range_rad)
        self._state = Px4State(commander=commander, estimator=estimator, flight=flight, gimbal=gimbal)
        commands = Px4Commands(self._state, server, seed + 2)
        messages = Px4Messages(self._state)
        super().__init__(vehicle, parameters, server, self._state, commands, messages, BOOTED_BEFORE_S, seed, step_s)

    @property
    def timesync_converged(self) -> bool:
        """True if the companion's stamps are used."""
        return self._state.timesync.converged

    def fuse_own(self, pose: PoseRecord) -> None:
        """Fuse a pose of its own tracking system, whose heading counts as known."""
        self._state.commander.heading_known = True
        super().fuse_own(pose)

    def pilot_takes_over(self, mode: str = "POSCTL") -> None:
        """Change the mode by a switch on the transmitter. Raises KeyError for an unknown mode."""
        self._state.commander.takeover(Px4Mode[mode])

    def pilot_disarms(self) -> None:
        """Disarm by the kill switch: the motors stop, even in flight."""
        self._state.commander.request_arming(arm=False, force=True, condition=self._state.condition())

    def _configure(self) -> None:
        p, s = self._parameters, self._state
        s.estimator.configure(estimator_tuning(p))
        s.flight.configure(p)
        s.commander.configure(p)

    def _reset_after_reboot(self) -> None:
        s = self._state
        s.estimator, s.timesync = Estimator(estimator_tuning(self._parameters)), Px4Timesync()
        s.commander.origin_at_s, s.commander.heading_known = math.inf, False
        s.commander.takeover(Px4Mode.ALTCTL)

    def _step_slow_tasks(self, dt_s: float) -> None:
        s = self._state
        self._sense_slowly(dt_s)
        if s.origin is not None and not s.commander.armed and s.estimator.started:
            s.home = s.estimator.position
        s.commander.step(s.condition())
        if s.flight.takeoff_complete:
            s.commander.request_mode(Px4Mode.LOITER, s.condition())

    def _control(self, dt_s: float, seen: Estimator | PilotView) -> tuple[Vec3, float]:
        s = self._state
        return s.flight.step(dt_s, s.commander.armed, s.commander.mode, seen)
