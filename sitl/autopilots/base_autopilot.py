"""Base of the simulated autopilots: fixed physics steps, MAVLink in and out, ground truth."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

from sitl.autopilots.autopilot_state import AutopilotState
from sitl.autopilots.base_commands import BaseCommands
from sitl.autopilots.base_messages import BaseMessages
from sitl.autopilots.ekf import Estimator, ExternalPose
from sitl.autopilots.mavlink_server import MavlinkServer
from sitl.autopilots.parameter_table import ParameterTable
from sitl.autopilots.pilot_view import PilotView
from sitl.geometry.ned_frd import frd_from_flu, ned_frd_from_enu_flu, ned_from_enu
from sitl.geometry.quaternion import Quat, Vec3, conjugate, rotate
from sitl.world.flow_sensor import FlowMeasurement, RangeMeasurement, SimulatedFlowModule
from sitl.world.imu import SimulatedImu
from sitl.world.pose_tracker import PoseRecord
from sitl.world.quadrotor import Quadrotor
from sitl.world.range_finder import SimulatedUpwardRangeFinder

_SLOW_S = 0.02  # period of commander and barometer (50 Hz)


@dataclass(frozen=True, slots=True)
class VehicleTruth:
    """True state of the vehicle: ENU, FLU, world clock.

    gimbal_pitch_down_rad is relative to the body.
    """

    stamp_s: float
    position: Vec3
    velocity: Vec3
    quat_wxyz: Quat
    gyro: Vec3
    specific_force: Vec3
    gimbal_pitch_down_rad: float
    armed: bool
    mode: str


class Autopilot(ABC):
    """An autopilot with its vehicle; step(now_s) does all physics and I/O up to that time.

    setpoint_arrivals_s: world-clock arrival of each setpoint received while armed and in the mode that follows setpoints.
    failsafes: descriptions of the failsafes that acted. texts: every STATUSTEXT sent.
    """

    version = ""  # set for a real firmware only

    def __init__(
        self,
        vehicle: Quadrotor,
        parameters: ParameterTable,
        server: MavlinkServer,
        board: AutopilotState,
        requests: BaseCommands,
        messages: BaseMessages,
        booted_before_s: float,
        seed: int,
        step_s: float,
    ) -> None:
        """Create the autopilot on the ground.

        booted_before_s: time from boot to the first step(). step_s: time step of physics, estimator and control, well below
        the lags of the vehicle.
        """
        self._step_s = step_s
        self._slow_steps = max(round(_SLOW_S / step_s), 1)
        self.vehicle = vehicle
        self.parameters = parameters
        self._imu = SimulatedImu(seed, step_s)
        self._server = server
        self._board = board
        self._requests = requests
        self._booted_before_s = booted_before_s
        self._started = False
        self._steps = 0
        self._revision = parameters.revision
        self._start_s = 0.0
        self._taken: tuple[FlowMeasurement | None, RangeMeasurement | None] = (None, None)
        self._pilot_view: PilotView | None = None  # set while a human pilot flies it without the estimator
        for message_id, (build, rate_hz) in messages.rates().items():
            server.add_stream(message_id, build, rate_hz)

    @property
    def setpoint_arrivals_s(self) -> list[float]:
        """World-clock arrivals (s) of setpoints while armed and following setpoints."""
        return self._requests.setpoint_arrivals_s

    @property
    def failsafes(self) -> list[str]:
        """Cause and action of each failsafe that acted, in order."""
        return self._board.commander.failsafes

    @property
    def texts(self) -> list[str]:
        """Every STATUSTEXT sent."""
        return self._server.texts

    @property
    def estimator(self) -> Estimator:
        """The estimator, for comparison with the truth."""
        return self._board.estimator

    def truth(self) -> VehicleTruth:
        """Return the true state of the vehicle at the last step."""
        v, b, c = self.vehicle, self._board, self._board.commander
        return VehicleTruth(
            b.now_s, v.position, v.velocity, v.quat_wxyz, v.gyro, v.specific_force, -b.gimbal.pitch, c.armed, c.mode.name
        )

    # -- pilot actions and injected faults ------------------------------------------------------------------------

    @abstractmethod
    def pilot_takes_over(self, mode: str = "") -> None:
        """Change the mode by a switch on the transmitter; '' is the manual position mode.

        Raises KeyError for an unknown mode.
        """

    @abstractmethod
    def pilot_disarms(self) -> None:
        """Disarm by the kill switch: the motors stop, even in flight."""

    def disable_land_detector(self) -> None:
        """Disable the land detector: no landing is detected any more."""
        self._board.flight.disable_land_detector()

    def write_parameter(self, name: str, value: float) -> None:
        """Change a parameter as another ground station would, and send its PARAM_VALUE.

        Raises KeyError for an unknown name.
        """
        self.parameters.set(name, value)
        self._server.send_parameter(name)

    def reboot(self) -> None:
        """Reboot in flight: clock, estimator, origin, home and message rates are reset.

        Unlike on a real vehicle the motors keep running, because otherwise the flight would end there. From then on a human
        pilot flies the vehicle by sight.
        """
        b = self._board
        b.boot_s, b.origin, b.home = b.now_s, None, None
        self._server.restart()
        self._reset_after_reboot()
        self._pilot_view = PilotView(self.vehicle)

    def transmitter(self, heard: bool) -> None:
        """Switch the pilot's RC transmitter on (True) or off."""
        self._board.rc_lost_at_s = math.inf if heard else self._board.now_s

    @property
    def battery_fraction(self) -> float:
        """State of charge, 0 to 1."""
        return self._board.battery.fraction

    @property
    def boot_s(self) -> float:
        """Time of boot, s on the world clock."""
        return self._board.boot_s

    def set_battery(self, fraction: float) -> None:
        """Set the state of charge, 0 to 1."""
        self._board.battery.fraction = fraction

    def mount_range_finder(self, sensor: SimulatedUpwardRangeFinder) -> None:
        """Connect a range finder that looks up."""
        self._board.range_finder = sensor

    def mount_flow_module(self, module: SimulatedFlowModule) -> None:
        """Connect an optical flow sensor and a range finder that look down."""
        self._board.flow_module = module

    def fuse_own(self, pose: PoseRecord) -> None:
        """Fuse a pose of the autopilot's own tracking system: z up, stamp on the world clock."""
        b = self._board
        x, y, z = pose.position_m.tolist()
        qw, qx, qy, qz = pose.quat_wxyz.tolist()
        b.estimator.take(
            ExternalPose(
                pose.stamp_s - b.boot_s,
                ned_from_enu((x, y, z)),
                ned_frd_from_enu_flu((qw, qx, qy, qz)),
                float(pose.variance[:3].max()),
                float(pose.variance[5]),
                pose.quality,
                pose.reset_counter,
            )
        )

    # -- time -----------------------------------------------------------------------------------------------------

    def step(self, now_s: float) -> None:
        """Advance to now_s on the world clock, in equal steps; the first call only sets the clock."""
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
            self._step_slow_tasks(self._step_s * self._slow_steps)
        self._act()
        b.gimbal.step(self._step_s)
        self._server.stream_out(b.now_s)
        self._server.flush()

    def _sense(self) -> None:
        v, b = self.vehicle, self._board
        gyro, force = self._imu.read(frd_from_flu(v.gyro), frd_from_flu(v.specific_force))
        b.estimator.predict(b.now_s - b.boot_s, self._step_s, gyro, force, b.flight.landed)
        if b.flow_module is not None:
            self._sense_floor(b.flow_module)

    def _sense_floor(self, module: SimulatedFlowModule) -> None:
        """Advance the module that looks down, and give new readings to the estimator.

        Only those that the parameters read.
        """
        v, b = self.vehicle, self._board
        module.step(b.now_s, v.position, v.quat_wxyz)
        tuning, (flow, distance) = b.estimator.flow_tuning, self._taken
        self._taken = (module.flow, module.distance)
        if tuning.range_read and module.distance is not None and module.distance is not distance and module.distance.valid:
            b.estimator.take_range(module.distance.range_m)
        if tuning.read and module.flow is not None and module.flow is not flow:
            b.estimator.take_flow(module.flow, module.flow.read_s - b.boot_s)

    def _act(self) -> None:
        """Control the vehicle for one step.

        The wanted force is computed with the estimated attitude and applied in the true one, so that estimation errors
        affect the flight.
        """
        v, b = self.vehicle, self._board
        seen = self._pilot_view or b.estimator
        force, turn = self._control(self._step_s, seen)
        in_body = frd_from_flu(rotate(conjugate(seen.quat_wxyz), force))
        v.step(self._step_s, rotate(v.quat_wxyz, in_body), -turn, self._board.commander.armed)

    def _sense_slowly(self, dt_s: float) -> None:
        """Update barometer, range finder and battery."""
        b = self._board
        if b.range_finder is not None:
            b.range_finder.step(b.now_s, self.vehicle.position, self.vehicle.quat_wxyz)
        b.estimator.correct_baro(self._imu.altitude(self.vehicle.position[2]), dt_s)
        b.battery.step(dt_s, b.commander.armed and not b.flight.landed)

    # -- implemented by each firmware -----------------------------------------------------------------------------

    @abstractmethod
    def _configure(self) -> None:
        """Apply changed parameters."""

    @abstractmethod
    def _step_slow_tasks(self, dt_s: float) -> None:
        """Run the 50 Hz tasks: slow sensors, home, commander."""

    @abstractmethod
    def _reset_after_reboot(self) -> None:
        """Reset estimator and clock offsets after a reboot, and enter a manual mode."""

    @abstractmethod
    def _control(self, dt_s: float, seen: Estimator | PilotView) -> tuple[Vec3, float]:
        """Return the wanted specific force (local NED, m/s^2) and yaw rate (about down, rad/s).

        seen: source of position, velocity and attitude.
        """
