"""What PX4's flight tasks want in each mode, take-off ramp and land detector included. Local NED."""

from __future__ import annotations

import math

from sitl.control import Controller, ControlSetpoint
from sitl.estimator import Estimator
from sitl.eyes import Eyes
from sitl.landing import LandDetector
from sitl.parameters import Parameters
from sitl.px4_modes import Mode
from sitl.px4_tuning import control_gains
from sitl.rotation import Vec3
from sitl.vehicle import GRAVITY_MPS2

_LAND_DETECT_S = 0.6
_IDLE: Vec3 = (0.0, 0.0, -0.1 * GRAVITY_MPS2)
_STOP = ControlSetpoint(velocity=(0.0, 0.0, 0.0))


class Flight:
    """Turns mode and setpoint into a wanted specific force and yaw rate, and knows whether the vehicle has landed."""

    def __init__(self, parameters: Parameters) -> None:
        self._controller = Controller(control_gains(parameters))
        self._ground = LandDetector(_LAND_DETECT_S)
        self.offboard = ControlSetpoint()
        self.active = ControlSetpoint()
        self.has_flown = False
        self._mode: Mode | None = None
        self._hold: Vec3 = (0.0, 0.0, 0.0)
        self._hold_yaw = 0.0
        self._ramp_s = -1.0  # time since the take-off began, negative before
        self._armed_s = 0.0
        self._ground_down = 0.0
        self.configure(parameters)

    def configure(self, parameters: Parameters) -> None:
        """Take over changed parameters."""
        p = parameters
        self._controller.configure(control_gains(p))
        self._spoolup_s, self._ramp_t, self._takeoff_speed = p["COM_SPOOLUP_TIME"], p["MPC_TKO_RAMP_T"], p["MPC_TKO_SPEED"]
        self._up, self._down, self._takeoff_height = p["MPC_Z_V_AUTO_UP"], p["MPC_Z_V_AUTO_DN"], p["MIS_TAKEOFF_ALT"]
        self._land = (p["MPC_LAND_ALT1"], p["MPC_LAND_ALT2"], p["MPC_LAND_SPEED"])
        self._brake = p["MPC_ACC_HOR"]

    def estimate_jumped(self, delta: Vec3, turn_rad: float) -> None:
        """Carry what is held along with the estimate; newer setpoints are the companion's own business."""
        self.offboard = self.offboard.shifted(delta, turn_rad)
        h = self._hold
        self._hold = (h[0] + delta[0], h[1] + delta[1], h[2] + delta[2])
        self._hold_yaw += turn_rad
        self._ground_down += delta[2]

    def lose_land_detector(self) -> None:
        """From now on no landing is noticed."""
        self._ground.blind = True

    @property
    def landed(self) -> bool:
        """The land detector's word."""
        return self._ground.landed

    @property
    def takeoff_complete(self) -> bool:
        """Whether take-off mode reached its height."""
        return self._mode is Mode.TAKEOFF and not self.landed and self._arrived

    def step(self, dt_s: float, armed: bool, mode: Mode, estimator: Estimator | Eyes) -> tuple[Vec3, float]:
        """Wanted specific force (local NED, m/s^2) and yaw rate (about down, rad/s)."""
        position, velocity = estimator.position, estimator.velocity
        if mode is not self._mode:
            self._begin(mode, position, velocity, estimator.yaw)
        if not armed:
            self._rest(position)
            self.has_flown = False
            self._armed_s = 0.0
            return (0.0, 0.0, 0.0), 0.0
        self._armed_s += dt_s
        setpoint = self._wanted(mode, position)
        self.active = setpoint
        if self.landed and not self._lifts_off(setpoint, position, dt_s):
            self._rest(position)
            return _IDLE, 0.0
        limit = math.inf
        if self._ramp_s < self._ramp_t:
            self._ramp_s += dt_s
            limit = self._takeoff_speed * min(1.0, self._ramp_s / max(self._ramp_t, 1e-3))
        if not estimator.horizontal_valid:
            down = setpoint.velocity[2] if mode is Mode.LAND else 0.0
            force, turn = self._controller.level(dt_s, velocity[2], down), 0.0
        else:
            a = estimator.acceleration
            force, turn = self._controller.step(dt_s, position, velocity, a, estimator.yaw, setpoint, limit)
        if self._ground.touched_down(dt_s, force, velocity):
            self._ramp_s = -1.0
        return force, turn

    def _begin(self, mode: Mode, position: Vec3, velocity: Vec3, yaw: float) -> None:
        """Hold where braking ends."""
        self._mode = mode
        self._arrived = False
        speed = math.hypot(velocity[0], velocity[1])
        ahead = speed / (2.0 * self._brake)
        self._hold = (position[0] + velocity[0] * ahead, position[1] + velocity[1] * ahead, position[2])
        self._hold_yaw = yaw

    def _wanted(self, mode: Mode, position: Vec3) -> ControlSetpoint:
        if mode is Mode.OFFBOARD:
            return self.offboard if self.offboard.valid else _STOP
        x, y, z = self._hold
        if mode is Mode.LAND:
            return ControlSetpoint((x, y, math.nan), (0.0, 0.0, self._landing_speed(position[2])), yaw=self._hold_yaw)
        if mode is Mode.TAKEOFF:
            top = self._ground_down - self._takeoff_height
            self._arrived = position[2] - top < 0.05
            climb = max(-self._up, 1.5 * (top - position[2]))
            return ControlSetpoint((x, y, math.nan), (0.0, 0.0, climb), yaw=self._hold_yaw)
        return ControlSetpoint((x, y, z), yaw=self._hold_yaw)

    def _landing_speed(self, down: float) -> float:
        high, low, slow = self._land
        height = self._ground_down - down
        f = min(max((height - low) / max(high - low, 1e-3), 0.0), 1.0)
        return slow + f * (self._down - slow)

    def _lifts_off(self, setpoint: ControlSetpoint, position: Vec3, dt_s: float) -> bool:
        if self._armed_s < self._spoolup_s:
            return False
        if setpoint.position[2] < position[2] - 0.1 or setpoint.velocity[2] < -0.1:
            self._ramp_s = max(self._ramp_s, 0.0)
        if self._ramp_s < 0.0:
            return False
        if self._ground_down - position[2] > 0.08:
            self._ground.lifted()
            self.has_flown = True
        return True

    def _rest(self, position: Vec3) -> None:
        self._controller.reset()
        self._ramp_s = -1.0
        self._ground.rest()
        self._ground_down = position[2]
