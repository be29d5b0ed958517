"""Setpoints of PX4's flight modes, with take-off ramp and land detector. Local NED.

An OFFBOARD setpoint goes to the controller unchanged: only the tilt limits its acceleration. The other modes follow a
smooth trajectory to a hold position where braking ends (if there is an origin; from the sources, see
trajectory_smoothing.py).
"""

from __future__ import annotations

import math

from sitl.autopilots.ekf import Estimator
from sitl.autopilots.land_detector import LandDetector
from sitl.autopilots.pilot_view import PilotView
from sitl.autopilots.position_controller import ControlSetpoint, PositionController
from sitl.autopilots.px4.commander import Px4Mode
from sitl.autopilots.px4.parameters import Px4Parameters
from sitl.autopilots.px4.trajectory_smoothing import TrajectorySmoothing
from sitl.autopilots.px4.tuning import control_gains, smoothing_limits
from sitl.geometry.quaternion import Vec3
from sitl.world.quadrotor import GRAVITY_MPS2

_LAND_DETECT_S = 0.6
_IDLE: Vec3 = (0.0, 0.0, -0.1 * GRAVITY_MPS2)
_STOP = ControlSetpoint(velocity=(0.0, 0.0, 0.0))


class Px4FlightTasks:
    """Controller from mode and setpoint to specific force and yaw rate, with the land detector."""

    def __init__(self, parameters: Px4Parameters) -> None:
        self._controller = PositionController(control_gains(parameters))
        self._ground = LandDetector(_LAND_DETECT_S)
        self.offboard = ControlSetpoint()
        self.active = ControlSetpoint()
        self.has_flown = False
        self._mode: Px4Mode | None = None
        self._entry: Vec3 = (0.0, 0.0, 0.0)  # position at which the current mode was entered
        self._course = (0.0, 0.0)  # horizontal unit vector of the velocity on entry; zero at rest
        self._stop_m = 0.0  # distance of the hold position from the entry, along the course
        self._level = TrajectorySmoothing()
        self._down = TrajectorySmoothing()
        self._hold_yaw = 0.0
        self._ramp_s = -1.0  # time since the take-off began, negative before
        self._armed_s = 0.0
        self._ground_down = 0.0
        self.configure(parameters)

    def configure(self, parameters: Px4Parameters) -> None:
        """Apply changed parameters."""
        p = parameters
        self._controller.configure(control_gains(p))
        self._spoolup_s = p["COM_SPOOLUP_TIME"]
        self._ramp_t = p["MPC_TKO_RAMP_T"]
        self._takeoff_speed = p["MPC_TKO_SPEED"]
        self._speed_up = p["MPC_Z_VEL_MAX_UP"]
        self._no_thrust_mps = -GRAVITY_MPS2 / p["MPC_Z_VEL_P_ACC"]
        self._takeoff_height = p["MIS_TAKEOFF_ALT"]
        self._land = (p["MPC_LAND_ALT1"], p["MPC_LAND_ALT2"], p["MPC_LAND_SPEED"], p["MPC_Z_V_AUTO_DN"])
        self._limits = smoothing_limits(p)

    def estimate_jumped(self, delta: Vec3, turn_rad: float) -> None:
        """Shift held positions and headings by a jump of the estimate, also the last setpoint."""
        self.offboard = self.offboard.shifted(delta, turn_rad)
        x, y, z = self._entry
        self._entry = (x + delta[0], y + delta[1], z + delta[2])
        self._down.position += delta[2]
        self._hold_yaw += turn_rad
        self._ground_down += delta[2]

    def disable_land_detector(self) -> None:
        """Disable the land detector: no landing is detected any more."""
        self._ground.blind = True

    @property
    def landed(self) -> bool:
        """True if the land detector reports that the vehicle has landed."""
        return self._ground.landed

    @property
    def takeoff_complete(self) -> bool:
        """True if TAKEOFF has reached its height."""
        return self._mode is Px4Mode.TAKEOFF and not self.landed and self._arrived

    def step(self, dt_s: float, armed: bool, mode: Px4Mode, estimator: Estimator | PilotView) -> tuple[Vec3, float]:
        """Return the wanted specific force (local NED, m/s^2) and yaw rate (about down, rad/s)."""
        position, velocity = estimator.position, estimator.velocity
        if mode is not self._mode:
            self._begin(mode, position, velocity, estimator.yaw)
        if not armed:
            self._rest(position)
            self.has_flown = False
            self._armed_s = 0.0
            return (0.0, 0.0, 0.0), 0.0
        self._armed_s += dt_s
        setpoint = self._wanted(mode, position, dt_s)
        self.active = setpoint
        controlled = self._controlled_velocity(setpoint, velocity, estimator.height_rate)
        if self.landed and not self._lifts_off(setpoint, position, dt_s):
            self._rest(position)
            return _IDLE, 0.0
        limit = math.inf
        if self._ramp_s < self._ramp_t:
            self._ramp_s += dt_s
            limit = self._ramped_mps(mode)
        if not estimator.horizontal_valid:
            down = setpoint.velocity[2] if mode is Px4Mode.LAND else 0.0
            force, turn = self._controller.level(dt_s, controlled[2], down), 0.0
        else:
            a = estimator.acceleration
            force, turn = self._controller.step(dt_s, position, controlled, a, estimator.yaw, setpoint, limit)
        if self._ground.touched_down(dt_s, force, velocity, estimator.horizontal_valid):
            self._ramp_s = -1.0
        return force, turn

    def _begin(self, mode: Px4Mode, position: Vec3, velocity: Vec3, yaw: float) -> None:
        """Start a trajectory from the present motion to the position where braking ends."""
        self._mode = mode
        self._arrived = False
        speed = math.hypot(velocity[0], velocity[1])
        self._course = (velocity[0] / speed, velocity[1] / speed) if speed > 0.0 else (0.0, 0.0)
        self._entry = position
        self._stop_m = self._limits[0].stopping_m(speed)
        self._level = TrajectorySmoothing(0.0, speed)
        self._down = TrajectorySmoothing(position[2], velocity[2])
        self._hold_yaw = yaw

    def _wanted(self, mode: Px4Mode, position: Vec3, dt_s: float) -> ControlSetpoint:
        if mode is Px4Mode.OFFBOARD:
            return self.offboard if self.offboard.valid else _STOP
        level, up, down = self._limits
        self._level.step(dt_s, level.speed_towards(self._stop_m - self._level.position), level)
        if mode is Px4Mode.LAND:
            self._down.step(dt_s, self._landing_speed(position[2]), down)
            return self._on_course(math.nan)
        top = self._entry[2]
        if mode is Px4Mode.TAKEOFF:
            top = self._ground_down - self._takeoff_height
            self._arrived = position[2] - top < 0.05
            self._down.position = position[2]  # the take-off ramp, not the trajectory, controls the climb
        away = top - self._down.position
        limits = up if away < 0.0 else down
        self._down.step(dt_s, limits.speed_towards(away), limits)
        return self._on_course(self._down.position)

    def _on_course(self, down: float) -> ControlSetpoint:
        (x, y, _), (north, east) = self._entry, self._course
        s, z = self._level, self._down
        return ControlSetpoint(
            (x + north * s.position, y + east * s.position, down),
            (north * s.velocity, east * s.velocity, z.velocity),
            (north * s.acceleration, east * s.acceleration, z.acceleration),
            self._hold_yaw,
        )

    def _controlled_velocity(self, setpoint: ControlSetpoint, velocity: Vec3, height_rate: float) -> Vec3:
        """Return the velocity for control.

        Without a height to hold, the vertical one is the derivative of the height, which has less bias. Below the landing speed
        the two are blended (from the sources, MulticopterPositionControl).
        """
        wanted = setpoint.velocity[2]
        if not math.isnan(setpoint.position[2]) or math.isnan(wanted):
            return velocity
        share = min(abs(wanted) / self._land[2], 1.0)
        return (velocity[0], velocity[1], share * height_rate + (1.0 - share) * velocity[2])

    def _landing_speed(self, down: float) -> float:
        high, low, slow, fast = self._land
        height = self._ground_down - down
        f = min(max((height - low) / max(high - low, 1e-3), 0.0), 1.0)
        return slow + f * (fast - slow)

    def _lifts_off(self, setpoint: ControlSetpoint, position: Vec3, dt_s: float) -> bool:
        if self._armed_s < self._spoolup_s:
            return False
        wanted = setpoint.position[2] < position[2] - 0.1 or setpoint.velocity[2] < -0.1
        if not self._arrived if self._mode is Px4Mode.TAKEOFF else wanted:
            self._ramp_s = max(self._ramp_s, 0.0)
        if self._ramp_s < 0.0:
            return False
        if self._ground_down - position[2] > 0.08:
            self._ground.lifted()
            self.has_flown = True
        return True

    def _ramped_mps(self, mode: Px4Mode) -> float:
        """Return the climb-rate limit (m/s) of the take-off ramp.

        It starts at the negative rate for which the thrust is zero (from the sources, and confirmed in flight on 1.17).
        """
        most = self._takeoff_speed if mode is Px4Mode.TAKEOFF else self._speed_up
        return self._no_thrust_mps + min(1.0, self._ramp_s / max(self._ramp_t, 1e-3)) * (most - self._no_thrust_mps)

    def _rest(self, position: Vec3) -> None:
        self._controller.reset()
        self._ramp_s = -1.0
        self._ground.rest()
        self._ground_down = position[2]
        self._entry = position
        self._stop_m = 0.0
        self._level = TrajectorySmoothing()
        self._down = TrajectorySmoothing(position[2])
