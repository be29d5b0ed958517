"""A PX4-like autopilot with its vehicle: fixed physics steps, MAVLink in and out, the truth for the referee."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sitl.estimator import Estimator
from sitl.frames import frd_from_flu
from sitl.gimbal import Gimbal
from sitl.imu import Imu
from sitl.mavlink_server import MavlinkServer
from sitl.pace import REAL
from sitl.parameters import Parameters
from sitl.px4_commands import Commands
from sitl.px4_flight import Flight
from sitl.px4_messages import Messages
from sitl.px4_modes import Commander, Mode
from sitl.px4_state import State
from sitl.rotation import Quat, Vec3, conjugate, rotate
from sitl.transport import ByteEnd
from sitl.vehicle import Quadrotor

BOOTED_BEFORE_S = 37.5  # the autopilot's clock is not the world's: stamps must go through TIMESYNC
_SLOW_S = 0.02  # commander and barometer at 50 Hz


@dataclass(frozen=True, slots=True)
class Truth:
    """What really is: ENU, FLU, on the world's clock. gimbal_pitch_down_rad is relative to the body."""

    stamp_s: float
    position: Vec3
    velocity: Vec3
    quat_wxyz: Quat
    gyro: Vec3
    specific_force: Vec3
    gimbal_pitch_down_rad: float
    armed: bool
    mode: str


class Px4:
    """The simulated autopilot. Nothing runs by itself: step(now_s) does physics and I/O up to that instant.

    setpoint_arrivals_s: world-clock arrival of each setpoint while armed and in OFFBOARD. failsafes: those that
    acted, in words. texts: every STATUSTEXT. Raises ValueError for parameters whose failsafe is not simulated.
    """

    def __init__(
        self, vehicle: Quadrotor, link: ByteEnd, parameters: Parameters, seed: int, step_s: float = REAL.physics_s
    ) -> None:
        """step_s: of physics, estimator and control; well below the lags of the vehicle."""
        self._step_s, self._slow_steps = step_s, max(round(_SLOW_S / step_s), 1)
        self.vehicle = vehicle
        self.parameters = parameters
        self._imu = Imu(seed, step_s)
        self._server = MavlinkServer(link, parameters)
        flight = Flight(parameters)
        estimator = Estimator(parameters, flight.estimate_jumped)
        commander = Commander(parameters, seed + 1, self._server.say)
        down, up = parameters["MNT_MIN_PITCH"], parameters["MNT_MAX_PITCH"]
        self._state = State(commander, estimator, flight, Gimbal(math.radians(down), math.radians(up)))
        self._commands = Commands(self._state, self._server, seed + 2)
        for message_id, (build, rate_hz) in Messages(self._state).rates().items():
            self._server.add_stream(message_id, build, rate_hz)
        self._started = False
        self._steps = 0
        self._revision = parameters.revision
        self._start_s = 0.0

    @property
    def setpoint_arrivals_s(self) -> list[float]:
        """World-clock arrivals of setpoints while armed and in OFFBOARD."""
        return self._commands.setpoint_arrivals_s

    @property
    def failsafes(self) -> list[str]:
        """What went wrong and what was done about it, in order."""
        return self._state.commander.failsafes

    @property
    def texts(self) -> list[str]:
        """Every STATUSTEXT sent."""
        return self._server.texts

    @property
    def contacts_ground(self) -> int:
        """How often the vehicle came down onto the floor."""
        return len(self.vehicle.touchdowns)

    @property
    def estimator(self) -> Estimator:
        """The estimator, for the referee."""
        return self._state.estimator

    @property
    def timesync_converged(self) -> bool:
        """Whether the companion's stamps are believed."""
        return self._state.timesync.converged

    def truth(self) -> Truth:
        """The vehicle as it really is at the last step."""
        v, s = self.vehicle, self._state
        mode = s.commander.mode.name
        return Truth(
            s.now_s, v.position, v.velocity, v.quat_wxyz, v.gyro, v.specific_force, -s.gimbal.pitch, s.commander.armed, mode
        )

    # -- a pilot and the world's accidents ------------------------------------------------------------------------

    def pilot_takes_over(self, mode: str = "POSCTL") -> None:
        """A switch on the transmitter. Raises KeyError for an unknown mode."""
        self._state.commander.takeover(Mode[mode])

    def pilot_disarms(self) -> None:
        """The kill switch: motors stop, wherever the vehicle is."""
        self._state.commander.request_arming(arm=False, force=True, condition=self._state.condition())

    def transmitter(self, heard: bool) -> None:
        """Switch the pilot's transmitter off or on."""
        self._state.rc_lost_at_s = math.inf if heard else self._state.now_s

    def set_battery(self, fraction: float) -> None:
        """Another state of charge, from now on."""
        self._state.battery.fraction = fraction

    # -- time -----------------------------------------------------------------------------------------------------

    def step(self, now_s: float) -> None:
        """Advance to now_s on the world's clock, in equal steps; the first call only sets the clock."""
        s = self._state
        if not self._started:
            self._started = True
            self._start_s = s.now_s = now_s
            s.boot_s = now_s - BOOTED_BEFORE_S
        target = math.floor((now_s - self._start_s) / self._step_s + 1e-6)
        self._server.drain(s.now_s)
        while self._steps < target:
            self._steps += 1
            s.now_s = self._start_s + self._steps * self._step_s
            self._substep()

    def _substep(self) -> None:
        s = self._state
        for arrival_s, message in self._server.messages(s.now_s):
            self._commands.take(message, arrival_s)
        if self.parameters.revision != self._revision:
            self._reconfigure()
        self._sense()
        if self._steps % self._slow_steps == 0:
            self._think()
        self._act()
        s.gimbal.step(self._step_s)
        self._server.stream_out(s.now_s)
        self._server.flush()

    def _reconfigure(self) -> None:
        self._revision = self.parameters.revision
        for part in (self._state.estimator, self._state.flight, self._state.commander):
            part.configure(self.parameters)

    def _sense(self) -> None:
        v, s = self.vehicle, self._state
        gyro, force = self._imu.read(frd_from_flu(v.gyro), frd_from_flu(v.specific_force))
        s.estimator.predict(s.now_s - s.boot_s, self._step_s, gyro, force, s.flight.landed)

    def _think(self) -> None:
        s = self._state
        dt = self._step_s * self._slow_steps
        s.estimator.correct_baro(self._imu.altitude(self.vehicle.position[2]), dt)
        s.battery.step(dt, s.commander.armed and not s.flight.landed)
        if s.origin is not None and not s.commander.armed and s.estimator.started:
            s.home = s.estimator.position
        s.commander.step(s.condition())
        if s.flight.takeoff_complete:
            s.commander.request_mode(Mode.LOITER, s.condition())

    def _act(self) -> None:
        """Carry the wanted force from the estimated attitude into the true one: estimation errors really fly."""
        v, s = self.vehicle, self._state
        force, turn = s.flight.step(self._step_s, s.commander.armed, s.commander.mode, s.estimator)
        in_body = frd_from_flu(rotate(conjugate(s.estimator.quat_wxyz), force))
        v.step(self._step_s, rotate(v.quat_wxyz, in_body), -turn, s.commander.armed)
