"""An ArduCopter-like autopilot with its vehicle."""

from __future__ import annotations

import math

from sitl.autopilots.ardupilot.commands import ArduPilotCommands
from sitl.autopilots.ardupilot.jitter_correction import JitterCorrection
from sitl.autopilots.ardupilot.messages import ArduPilotMessages
from sitl.autopilots.ardupilot.mode_controllers import ArduPilotModeControllers
from sitl.autopilots.ardupilot.modes import ArduPilotCommander, ArduPilotMode
from sitl.autopilots.ardupilot.parameters import ArduPilotParameters
from sitl.autopilots.ardupilot.state import ArduPilotState
from sitl.autopilots.ardupilot.tuning import estimator_tuning
from sitl.autopilots.base_autopilot import Autopilot
from sitl.autopilots.byte_links import ByteEnd
from sitl.autopilots.ekf import Estimator
from sitl.autopilots.mavlink_server import MavlinkServer
from sitl.autopilots.pilot_view import PilotView
from sitl.geometry.quaternion import Vec3
from sitl.world.gimbal import Gimbal
from sitl.world.pose_tracker import PoseRecord
from sitl.world.quadrotor import Quadrotor
from sitl.world.step_sizes import FINE_STEPS

BOOTED_BEFORE_S = 12.5  # time from boot to the first step; the pre-arm checks pass 25 s after boot


class ArduCopter(Autopilot):
    """The simulated ArduCopter. Raises ValueError if a parameter's failsafe is not simulated."""

    def __init__(
        self,
        vehicle: Quadrotor,
        link: ByteEnd,
        parameters: ArduPilotParameters,
        seed: int,
        step_s: float = FINE_STEPS.physics_s,
    ) -> None:
        """Create the autopilot. step_s: time step of physics, estimator and control, at most 20 ms."""
        self._parameters = parameters
        server = MavlinkServer(link, parameters)
        flight = ArduPilotModeControllers(parameters)
        estimator = Estimator(estimator_tuning(parameters), flight.estimate_jumped)
        commander = ArduPilotCommander(parameters, server.say)
        gimbal = Gimbal(math.radians(parameters["MNT1_PITCH_MIN"]), math.radians(parameters["MNT1_PITCH_MAX"]))
        self._state = ArduPilotState(
            commander=commander, estimator=estimator, flight=flight, gimbal=gimbal, capacity_mah=parameters["BATT_CAPACITY"]
        )
        commands = ArduPilotCommands(self._state, server)
        messages = ArduPilotMessages(self._state)
        super().__init__(vehicle, parameters, server, self._state, commands, messages, BOOTED_BEFORE_S, seed, step_s)

    def fuse_own(self, pose: PoseRecord) -> None:
        """Fuse a pose of its own tracking system, once the estimator is active."""
        if self._state.ekf_active:
            super().fuse_own(pose)

    def pilot_takes_over(self, mode: str = "LOITER") -> None:
        """Change the mode by a switch on the transmitter. Raises KeyError for an unknown mode."""
        self._state.commander.takeover(ArduPilotMode[mode])

    def pilot_disarms(self) -> None:
        """Disarm by the kill switch: the motors stop, even in flight."""
        self._state.commander.request_arming(arm=False, force=True, c=self._state.condition())

    def _reset_after_reboot(self) -> None:
        s = self._state
        s.estimator, s.jitter = Estimator(estimator_tuning(self._parameters)), JitterCorrection()
        s.home_follows, s.flight.home = False, None
        s.commander.gcs_received_s = s.commander.companion_received_s = math.inf
        s.commander.takeover(ArduPilotMode.STABILIZE)

    def _configure(self) -> None:
        p, s = self._parameters, self._state
        s.estimator.configure(estimator_tuning(p))
        s.flight.configure(p)
        s.commander.configure(p)
        s.capacity_mah = p["BATT_CAPACITY"]

    def _step_slow_tasks(self, dt_s: float) -> None:
        s = self._state
        self._sense_slowly(dt_s)
        s.settle_home()
        s.commander.step(s.condition())

    def _control(self, dt_s: float, seen: Estimator | PilotView) -> tuple[Vec3, float]:
        s = self._state
        return s.flight.step(dt_s, s.commander.armed, s.commander.mode, seen, s.commander.pause_s)
