"""What every simulated autopilot does with its vehicle: fixed physics steps, MAVLink in and out, the truth for the referee."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

from sitl.autopilots.autopilot_state import AutopilotState
from sitl.autopilots.base_commands import BaseCommands
from sitl.autopilots.ekf import Estimator
from sitl.autopilots.mavlink_server import MavlinkServer
from sitl.autopilots.parameter_table import ParameterTable
from sitl.autopilots.pilot_view import PilotView
from sitl.geometry.ned_frd import frd_from_flu
from sitl.geometry.quaternion import Quat, Vec3, conjugate, rotate
from sitl.world.imu import Imu
from sitl.world.quadrotor import Quadrotor

_SLOW_S = 0.02  # commander and barometer at 50 Hz


@dataclass(frozen=True, slots=True)
class VehicleTruth:
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


class Decides(Protocol):
    """Who holds mode and motors."""

    armed: bool
    failsafes: list[str]

    @property
    def mode(self) -> IntEnum:
        """The mode it is in."""
        ...


class Autopilot(ABC):
    """Nothing runs by itself: step(now_s) does physics and I/O up to that instant.

    setpoint_arrivals_s: world-clock arrival of each setpoint while armed and flying by them. failsafes: those that
    acted, in words. texts: every STATUSTEXT.
    """

    version = ""  # a real firmware has one

    def __init__(
        self,
        vehicle: Quadrotor,
        parameters: ParameterTable,
        server: MavlinkServer,
        board: AutopilotState,
        commander: Decides,
        requests: BaseCommands,
        booted_before_s: float,
        seed: int,
        step_s: float,
    ) -> None:
        """step_s: of physics, estimator and control; well below the lags of the vehicle."""
        self._step_s, self._slow_steps = step_s, max(round(_SLOW_S / step_s), 1)
        self.vehicle, self.parameters = vehicle, parameters
        self._imu = Imu(seed, step_s)
        self._server, self._board, self._commander, self._requests = server, board, commander, requests
        self._booted_before_s = booted_before_s
        self._started = False
        self._steps = 0
        self._revision = parameters.revision
        self._start_s = 0.0
        self._eyes: PilotView | None = None  # of a pilot who flies it without the estimator

    @property
    def setpoint_arrivals_s(self) -> list[float]:
        """World-clock arrivals of setpoints while armed and flying by them."""
        return self._requests.setpoint_arrivals_s

    @property
    def failsafes(self) -> list[str]:
        """What went wrong and what was done about it, in order."""
        return self._commander.failsafes

    @property
    def texts(self) -> list[str]:
        """Every STATUSTEXT sent."""
        return self._server.texts

    @property
    def estimator(self) -> Estimator:
        """The estimator, for the referee."""
        return self._board.estimator

    def truth(self) -> VehicleTruth:
        """The vehicle as it really is at the last step."""
        v, b, c = self.vehicle, self._board, self._commander
        return VehicleTruth(
            b.now_s, v.position, v.velocity, v.quat_wxyz, v.gyro, v.specific_force, -b.gimbal.pitch, c.armed, c.mode.name
        )

    # -- a pilot and the world's accidents ------------------------------------------------------------------------

    @abstractmethod
    def pilot_takes_over(self, mode: str = "") -> None:
        """A switch on the transmitter; '' is what a human flies by position. Raises KeyError for an unknown mode."""

    @abstractmethod
    def pilot_disarms(self) -> None:
        """The kill switch: motors stop, wherever the vehicle is."""

    @abstractmethod
    def lose_land_detector(self) -> None:
        """From now on no landing is noticed."""

    def write_parameter(self, name: str, value: float) -> None:
        """By a ground station elsewhere: it is told of on every link. Raises KeyError for an unknown name."""
        self.parameters.set(name, value)
        self._server.send_parameter(name)

    def reboot(self) -> None:
        """It starts anew where it is, and knows nothing of before: no clock, estimator, origin, home or message rates.

        The motors run on, as no real one's do: there would be nothing left to judge. A pilot flies it from then on, by eye.
        """
        b = self._board
        b.boot_s, b.origin, b.home = b.now_s, None, None
        self._server.restart()
        self._forget()
        self._eyes = PilotView(self.vehicle)

    def transmitter(self, heard: bool) -> None:
        """Switch the pilot's transmitter off or on."""
        self._board.rc_lost_at_s = math.inf if heard else self._board.now_s

    @property
    def battery_fraction(self) -> float:
        """State of charge now."""
        return self._board.battery.fraction

    @property
    def boot_s(self) -> float:
        """When it booted, on the world's clock."""
        return self._board.boot_s

    def set_battery(self, fraction: float) -> None:
        """Another state of charge, from now on."""
        self._board.battery.fraction = fraction

    # -- time -----------------------------------------------------------------------------------------------------

    def step(self, now_s: float) -> None:
        """Advance to now_s on the world's clock, in equal steps; the first call only sets the clock."""
        b = self._board
        if not self._started:
            self._started = True
            self._start_s = b.now_s = now_s
            b.boot_s = now_s - self._booted_before_s
        target = math.floor((now_s - self._start_s) / self._step_s + 1e-6)
        self._server.drain(b.now_s)
        while self._steps < target:
            self._steps += 1
            b.now_s = self._start_s + self._steps * self._step_s
            self._substep()

    def _substep(self) -> None:
        b = self._board
        for arrival_s, message in self._server.messages(b.now_s):
            self._requests.take(message, arrival_s)
        if self.parameters.revision != self._revision:
            self._revision = self.parameters.revision
            self._configure()
        self._sense()
        if self._steps % self._slow_steps == 0:
            self._think(self._step_s * self._slow_steps)
        self._act()
        b.gimbal.step(self._step_s)
        self._server.stream_out(b.now_s)
        self._server.flush()

    def _sense(self) -> None:
        v, b = self.vehicle, self._board
        gyro, force = self._imu.read(frd_from_flu(v.gyro), frd_from_flu(v.specific_force))
        b.estimator.predict(b.now_s - b.boot_s, self._step_s, gyro, force, self._landed)

    def _act(self) -> None:
        """Carry the wanted force from the estimated attitude into the true one: estimation errors really fly."""
        v, b = self.vehicle, self._board
        seen = self._eyes or b.estimator
        force, turn = self._fly(self._step_s, seen)
        in_body = frd_from_flu(rotate(conjugate(seen.quat_wxyz), force))
        v.step(self._step_s, rotate(v.quat_wxyz, in_body), -turn, self._commander.armed)

    def _sense_slowly(self, dt_s: float) -> None:
        """Barometer and battery."""
        b = self._board
        b.estimator.correct_baro(self._imu.altitude(self.vehicle.position[2]), dt_s)
        b.battery.step(dt_s, self._commander.armed and not self._landed)

    # -- the firmware's own ---------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def _landed(self) -> bool:
        """The land detector's word."""

    @abstractmethod
    def _configure(self) -> None:
        """Take over changed parameters."""

    @abstractmethod
    def _think(self, dt_s: float) -> None:
        """Decide, 50 times a second."""

    @abstractmethod
    def _forget(self) -> None:
        """A new estimator, nothing learned of foreign clocks, and the mode of a pilot on the sticks."""

    @abstractmethod
    def _fly(self, dt_s: float, seen: Estimator | PilotView) -> tuple[Vec3, float]:
        """Wanted specific force (local NED, m/s^2) and yaw rate (about down, rad/s), by what is seen of the vehicle."""
