"""Setpoints of ArduCopter's modes: GUIDED with target timeout, take-off, LAND, hold. NED.

GUIDED is from mode_guided.cpp and measurements: a position target has no timeout; a velocity, alone or moving a position
target along, ends GUID_TIMEOUT after its last target. On the ground only a take-off command lifts off. LAND brakes to rest
within GUIDED's limits of acceleration and jerk (from Mode::land_run_horizontal_control); a LAND started by a failsafe first
keeps its height for a pause (set_mode_land_with_pause).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from sitl.autopilots.ardupilot.input_shaping import InputShaper
from sitl.autopilots.ardupilot.modes import ArduPilotMode
from sitl.autopilots.ardupilot.parameters import ArduPilotParameters
from sitl.autopilots.ardupilot.tuning import control_gains, shaping_limits
from sitl.autopilots.ekf import Estimator
from sitl.autopilots.land_detector import LandDetector
from sitl.autopilots.pilot_view import PilotView
from sitl.autopilots.position_controller import ControlSetpoint, PositionController
from sitl.geometry.quaternion import Vec3
from sitl.world.quadrotor import GRAVITY_MPS2

_LAND_DETECT_S = 1.0
_ARMING_DELAY_S = 2.0
_ARRIVED_M = 0.05
_IDLE: Vec3 = (0.0, 0.0, -0.1 * GRAVITY_MPS2)
_STILL: Vec3 = (0.0, 0.0, 0.0)
_STOP_AT_FENCE = 1  # AVOID_ENABLE


@dataclass(frozen=True, slots=True)
class ControllerTarget:
    """One SET_POSITION_TARGET_LOCAL_NED as GUIDED uses it.

    Without position the velocity is followed alone. A NaN yaw or yaw_rate is not controlled.
    """

    position: Vec3 | None
    velocity: Vec3
    acceleration: Vec3
    yaw: float
    yaw_rate: float


class ArduPilotModeControllers:
    """Controller from mode and target to specific force and yaw rate, with the land detector."""

    def __init__(self, parameters: ArduPilotParameters) -> None:
        self._controller = PositionController(control_gains(parameters))
        self._ground = LandDetector(_LAND_DETECT_S)
        self._shaper = InputShaper(*shaping_limits(parameters))
        self.active = ControlSetpoint()
        self.home: Vec3 | None = None
        self._mode: ArduPilotMode | None = None
        self._target: ControllerTarget | None = None
        self._target_age_s = 0.0
        self._takeoff_goal_down: float | None = None  # goal of the current take-off, local down, m
        self._hold: Vec3 = _STILL
        self._hold_yaw = 0.0
        self._armed_s = 0.0
        self._ground_down = 0.0
        self._pause_s = 0.0
        self._motion = _STILL, _STILL
        self.configure(parameters)

    def configure(self, parameters: ArduPilotParameters) -> None:
        """Apply changed parameters."""
        p = parameters
        self._controller.configure(control_gains(p))
        self._shaper.limits = shaping_limits(p)
        self._spool_s = _ARMING_DELAY_S + p["MOT_SPOOL_TIME"]
        self._timeout_s = p["GUID_TIMEOUT"]
        self._climb = p["WP_SPD_UP"]
        self._brake = p["WP_ACC"]
        high = p["LAND_SPD_HIGH_MS"] or p["WP_SPD_DN"]
        self._land = (p["LAND_ALT_LOW_M"], high, p["LAND_SPD_MS"])
        avoiding = p.integer("AVOID_ENABLE") & _STOP_AT_FENCE and p.integer("FENCE_ENABLE") and p.integer("FENCE_TYPE") & 2
        self._keep_within_m = p["FENCE_RADIUS"] - p["FENCE_MARGIN"] if avoiding else math.inf

    def disable_land_detector(self) -> None:
        """Disable the land detector: no landing is detected any more."""
        self._ground.blind = True

    @property
    def landed(self) -> bool:
        """True if the land detector reports that the vehicle has landed."""
        return self._ground.landed

    @property
    def taking_off(self) -> bool:
        """True during a take-off."""
        return self._takeoff_goal_down is not None and not self.landed

    def estimate_jumped(self, delta: Vec3, turn_rad: float) -> None:
        """Shift held positions and headings by a jump of the estimate; a target is not shifted."""
        h = self._hold
        self._hold = (h[0] + delta[0], h[1] + delta[1], h[2] + delta[2])
        self._hold_yaw += turn_rad
        self._shaper.shift(delta)
        self._ground_down += delta[2]
        if self._takeoff_goal_down is not None:
            self._takeoff_goal_down += delta[2]

    def take_off(self, height_m: float) -> None:
        """Climb to a height above home, or above the ground without a home."""
        zero = self._ground_down if self.home is None else self.home[2]
        self._takeoff_goal_down = zero - height_m
        self._target = None

    def follow(self, target: ControllerTarget) -> None:
        """Follow a new target in GUIDED; it ends a take-off."""
        if self._target is None:
            self._shaper.reset(*self._motion)
        self._target = target
        self._target_age_s = 0.0
        self._takeoff_goal_down = None

    def stop(self, position: Vec3, yaw: float) -> None:
        """Hold the position in GUIDED, after an unusable target."""
        self._target = None
        self._takeoff_goal_down = None
        self._hold = position
        self._hold_yaw = yaw

    def step(
        self, dt_s: float, armed: bool, mode: ArduPilotMode, estimator: Estimator | PilotView, pause_s: float = 0.0
    ) -> tuple[Vec3, float]:
        """Return the wanted specific force (local NED, m/s^2) and yaw rate (about down, rad/s).

        pause_s: pause before the descent of a LAND.
        """
        position, velocity = estimator.position, estimator.velocity
        self._motion = position, velocity
        if mode is not self._mode:
            self._begin(mode, position, velocity, estimator.yaw)
            self._pause_s = pause_s
        self._pause_s -= dt_s
        if not armed:
            self._rest(position)
            self._target = None
            self._takeoff_goal_down = None
            self._armed_s = 0.0
            return _STILL, 0.0
        self._armed_s += dt_s
        if self.landed and not self._lifts_off(position):
            self._rest(position)
            return _IDLE, 0.0
        self.active = setpoint = self._wanted(dt_s, position)
        moves_height = math.isnan(
            setpoint.position[2]
        )  # its target moves: a velocity error shifts the height, and not its rate
        controlled = (velocity[0], velocity[1], estimator.height_rate) if moves_height else velocity
        if not estimator.horizontal_valid:
            down = setpoint.velocity[2] if mode is ArduPilotMode.LAND else 0.0
            force, turn = self._controller.level(dt_s, controlled[2], down), 0.0
        else:
            a = estimator.acceleration
            force, turn = self._controller.step(dt_s, position, controlled, a, estimator.yaw, setpoint)
        if self._ground.touched_down(dt_s, force, velocity, estimator.horizontal_valid):
            self._takeoff_goal_down = None
        return force, turn

    def _begin(self, mode: ArduPilotMode, position: Vec3, velocity: Vec3, yaw: float) -> None:
        """Enter a mode: hold where braking ends.

        A landing brakes from the commanded motion if there is a target, otherwise from the present motion.
        """
        if self._target is None:
            self._shaper.reset(position, velocity)
        self._mode = mode
        self._target = None
        self._takeoff_goal_down = None
        ahead_s = math.hypot(velocity[0], velocity[1]) / (2.0 * self._brake)
        self._hold = (position[0] + velocity[0] * ahead_s, position[1] + velocity[1] * ahead_s, position[2])
        self._hold_yaw = yaw

    def _wanted(self, dt_s: float, position: Vec3) -> ControlSetpoint:
        x, y, z = self._hold
        if self._mode is ArduPilotMode.LAND:
            return self._landing(dt_s, position)
        if self._mode is ArduPilotMode.GUIDED and self._takeoff_goal_down is not None:
            return self._climbing(self._takeoff_goal_down, position)
        if self._mode is ArduPilotMode.GUIDED and self._target is not None:
            return self._guided(self._target, dt_s, position)
        return ControlSetpoint((x, y, z), yaw=self._hold_yaw)

    def _landing(self, dt_s: float, position: Vec3) -> ControlSetpoint:
        s = self._shaper
        s.step(dt_s, None, _STILL, _STILL)
        (x, y, _), (north, east, _), (push_north, push_east, _) = s.position, s.velocity, s.acceleration
        sink = self._landing_speed(position[2])
        return ControlSetpoint((x, y, math.nan), (north, east, sink), (push_north, push_east, 0.0), self._hold_yaw)

    def _climbing(self, top: float, position: Vec3) -> ControlSetpoint:
        x, y, _ = self._hold
        if position[2] - top < _ARRIVED_M:
            self._hold = (x, y, top)
            self._takeoff_goal_down = None
            return ControlSetpoint(self._hold, yaw=self._hold_yaw)
        climb = max(-self._climb, 1.5 * (top - position[2]) - 0.05)
        return ControlSetpoint((x, y, math.nan), (0.0, 0.0, climb), yaw=self._hold_yaw)

    def _guided(self, target: ControllerTarget, dt_s: float, position: Vec3) -> ControlSetpoint:
        """Return the setpoint of a target, whose position moves with its velocity until the timeout."""
        self._target_age_s += dt_s
        if self._target_age_s > self._timeout_s:
            target = replace(target, velocity=_STILL, acceleration=_STILL, yaw_rate=0.0)
        place, velocity = target.position, target.velocity
        if place is None:
            velocity = self._avoiding(velocity, position)
        else:
            x, y, z = place
            place = (x + velocity[0] * dt_s, y + velocity[1] * dt_s, z + velocity[2] * dt_s)
        self._target = replace(target, position=place)
        self._shaper.step(dt_s, place, velocity, target.acceleration)
        s, yaw = self._shaper, target.yaw
        yaw = self._hold_yaw if math.isnan(yaw) and math.isnan(target.yaw_rate) else yaw
        return ControlSetpoint(s.position, s.velocity, s.acceleration, yaw, target.yaw_rate)

    def _avoiding(self, velocity: Vec3, position: Vec3) -> Vec3:
        """Return the velocity limited so that the vehicle can stop at the fence's margin.

        AVOID_ENABLE does so for velocity targets only.
        """
        if self.home is None or self._keep_within_m == math.inf:
            return velocity
        x, y = position[0] - self.home[0], position[1] - self.home[1]
        distance = math.hypot(x, y)
        outward = (velocity[0] * x + velocity[1] * y) / max(distance, 1e-6)
        allowed = math.sqrt(max(0.5 * self._brake * (self._keep_within_m - distance), 0.0))
        if outward <= allowed:
            return velocity
        cut = (outward - allowed) / max(distance, 1e-6)
        return (velocity[0] - cut * x, velocity[1] - cut * y, velocity[2])

    def _landing_speed(self, down: float) -> float:
        low_m, high, slow = self._land
        if self._pause_s > 0.0:
            return 0.0
        return high if self._ground_down - down > low_m else slow

    def _lifts_off(self, position: Vec3) -> bool:
        if self._takeoff_goal_down is None or self._mode is not ArduPilotMode.GUIDED or self._armed_s < self._spool_s:
            return False
        if self._ground_down - position[2] > 0.08:
            self._ground.lifted()
        return True

    def _rest(self, position: Vec3) -> None:
        self._controller.reset()
        self._ground.rest()
        self._ground_down = position[2]
        self._hold = position
