"""Quadrotor dynamics: first-order attitude and thrust lags, drag, gusts, ground contact.

World ENU, body FLU, metres, radians, seconds. The world's origin is the body's centre while it stands on the pad,
so the body rests at z = 0 (its skids reach 0.10 m lower).
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass

from sitl.geometry.quaternion import IDENTITY, Quat, Vec3, conjugate, from_yaw, multiply, normalised, rotate, small_rotation

GRAVITY_MPS2 = 9.80665


@dataclass(frozen=True, slots=True)
class AirframeDynamics:
    """Constants of a 250-size indoor quadrotor."""

    tilt_lag_s: float = 0.08  # first order, thrust axis
    yaw_rate_lag_s: float = 0.10  # first order
    thrust_lag_s: float = 0.04  # first order, motors
    max_tilt_rad: float = math.radians(45.0)
    max_thrust_mps2: float = 2.0 * GRAVITY_MPS2  # twice the hover thrust
    max_yaw_rate_radps: float = math.radians(200.0)
    max_speed_mps: float = 8.0  # keeps the integration bounded
    drag_per_s: float = 0.15  # linear, on the airspeed
    floor_friction_mps2: float = 4.0  # skids on the floor
    gust_time_s: float = 1.5  # correlation time of the wind


def bare_floor(position: Vec3) -> float:
    """Return -inf: no object stands on the floor anywhere."""
    return -math.inf


class Quadrotor:
    """True state and motion of the vehicle.

    It starts on the pad at `start` (m), heading `yaw_rad` (0 = east).
    wind_mps: rms of the gusts per horizontal axis (a third of it vertically); indoors 0.1 to 0.2.
    support_height_m: returns the height of the body's centre (m) when it rests on the object straight below a position, -inf
    without one. It counts where it is above the pad's floor. Objects do not stop the vehicle from the side; such contacts
    are detected by sitl/apps/flight_judge.py.

    Attributes after each step():
    position (m), velocity (m/s): ENU.
    quat_wxyz: enu_from_flu.
    gyro: FLU, rad/s.
    specific_force: FLU, m/s^2; the reading of an ideal accelerometer.
    external_acceleration_mps2: ENU; external force divided by the mass, set by the caller. The accelerometer measures it.
    external_turn_rate_radps: ENU; rate at which an external torque tilts it, set by the caller. The gyro measures it.
    on_ground: True while it rests on the floor or on an object.
    touchdowns: impact speeds of the landings, m/s.
    """

    def __init__(
        self,
        seed: int,
        wind_mps: float = 0.15,
        start: Vec3 = (0.0, 0.0, 0.0),
        yaw_rad: float = 0.0,
        airframe: AirframeDynamics | None = None,
        support_height_m: Callable[[Vec3], float] = bare_floor,
    ) -> None:
        self._frame = airframe or AirframeDynamics()
        self._standing_m = support_height_m
        self._random = random.Random(seed)
        self._wind_rms = wind_mps
        self._gust: Vec3 = (0.0, 0.0, 0.0)
        self._floor = start[2]
        self._thrust = 0.0
        self._up: Vec3 = (0.0, 0.0, 1.0)
        self._yaw = yaw_rad
        self._yaw_rate = 0.0
        self._step_s = 0.0
        self._gains = (0.0, 0.0, 0.0, 0.0, 0.0)
        self._highest = 0.0
        self._share = 1.0  # delivered thrust divided by wanted thrust
        self.position: Vec3 = start
        self.velocity: Vec3 = (0.0, 0.0, 0.0)
        self.quat_wxyz: Quat = multiply(IDENTITY, from_yaw(yaw_rad))
        self.gyro: Vec3 = (0.0, 0.0, 0.0)
        self.specific_force: Vec3 = (0.0, 0.0, GRAVITY_MPS2)
        self.external_acceleration_mps2: Vec3 = (0.0, 0.0, 0.0)
        self.external_turn_rate_radps: Vec3 = (0.0, 0.0, 0.0)
        self.on_ground = True
        self.touchdowns: list[float] = []

    def set_thrust_ratio(self, share: float) -> None:
        """Deliver this share of the wanted thrust: an overloaded vehicle or a failed motor."""
        self._share = share

    def push(self, velocity_change: Vec3) -> None:
        """Add velocity_change (ENU, m/s) to the velocity at once, to simulate a hit."""
        v = self.velocity
        self.velocity = (v[0] + velocity_change[0], v[1] + velocity_change[1], v[2] + velocity_change[2])

    def step(self, dt_s: float, specific_thrust_world: Vec3, yaw_rate_radps: float, motors_on: bool) -> None:
        """Advance by dt_s, which must be well below the lags (20 ms at most).

        specific_thrust_world: wanted rotor force divided by mass, ENU, m/s^2. Gravity is NOT added here: hovering
        is (0, 0, 9.80665); the zero vector means motors at idle.
        yaw_rate_radps: wanted yaw rate, counter-clockwise seen from above.
        """
        if dt_s != self._step_s:
            self._prepare(dt_s)
        wanted_up, wanted_thrust = self._command(specific_thrust_world, motors_on)
        self._turn(dt_s, wanted_up, yaw_rate_radps if motors_on else 0.0)
        up = self._up
        self._thrust += self._gains[2] * (self._share * wanted_thrust - self._thrust)
        wind = self._blow()
        drag = 0.0 if self.on_ground else self._frame.drag_per_s
        v, outside = self.velocity, self.external_acceleration_mps2
        ax = self._thrust * up[0] - drag * (v[0] - wind[0]) + outside[0]
        ay = self._thrust * up[1] - drag * (v[1] - wind[1]) + outside[1]
        az = self._thrust * up[2] - drag * (v[2] - wind[2]) + outside[2] - GRAVITY_MPS2
        self._move(dt_s, ax, ay, az)
        change = self.velocity
        force = ((change[0] - v[0]) / dt_s, (change[1] - v[1]) / dt_s, (change[2] - v[2]) / dt_s + GRAVITY_MPS2)
        self.specific_force = rotate(conjugate(self.quat_wxyz), force)

    def _prepare(self, dt_s: float) -> None:
        f = self._frame
        decay = math.exp(-dt_s / f.gust_time_s)
        self._step_s = dt_s
        self._gains = (
            1.0 - math.exp(-dt_s / f.tilt_lag_s),
            1.0 - math.exp(-dt_s / f.yaw_rate_lag_s),
            1.0 - math.exp(-dt_s / f.thrust_lag_s),
            decay,
            self._wind_rms * math.sqrt(1.0 - decay * decay),
        )

    def _command(self, force: Vec3, motors_on: bool) -> tuple[Vec3, float]:
        """Return the wanted thrust axis (tilt-limited) and the thrust on the present axis, m/s^2."""
        if not motors_on:
            return (self._up, 0.0)
        fx, fy, fz = force
        up = self._up
        thrust = min(max(fx * up[0] + fy * up[1] + fz * up[2], 0.0), self._frame.max_thrust_mps2)
        if self.on_ground and fz < GRAVITY_MPS2:
            return ((0.0, 0.0, 1.0), thrust)
        lift = max(fz, 0.2 * GRAVITY_MPS2)  # keeps the axis pointing up when a fast descent is commanded
        side = math.hypot(fx, fy)
        most = lift * math.tan(self._frame.max_tilt_rad)
        if side > most:
            fx, fy, side = fx * most / side, fy * most / side, most
        norm = math.sqrt(side * side + lift * lift)
        return ((fx / norm, fy / norm, lift / norm), thrust)

    def _turn(self, dt_s: float, wanted_up: Vec3, yaw_rate: float) -> None:
        limit = self._frame.max_yaw_rate_radps
        wanted_rate = 0.0 if self.on_ground else min(max(yaw_rate, -limit), limit)
        self._yaw_rate += self._gains[1] * (wanted_rate - self._yaw_rate)
        self._yaw += self._yaw_rate * dt_s
        k = self._gains[0]
        ux, uy, uz = self._up
        wx, wy, wz = self.external_turn_rate_radps
        ux, uy, uz = (
            ux + k * (wanted_up[0] - ux) + dt_s * (wy * uz - wz * uy),
            uy + k * (wanted_up[1] - uy) + dt_s * (wz * ux - wx * uz),
            uz + k * (wanted_up[2] - uz) + dt_s * (wx * uy - wy * ux),
        )
        norm = 1.0 / math.sqrt(ux * ux + uy * uy + uz * uz)
        self._up = (ux * norm, uy * norm, uz * norm)
        # first the heading, then the shortest rotation from the vertical onto the thrust axis
        tilt = normalised((1.0 + self._up[2], -self._up[1], self._up[0], 0.0))
        attitude = multiply(tilt, from_yaw(self._yaw))
        turn = small_rotation(multiply(conjugate(self.quat_wxyz), attitude))
        self.gyro = (turn[0] / dt_s, turn[1] / dt_s, turn[2] / dt_s)
        self.quat_wxyz = attitude

    def _blow(self) -> Vec3:
        """Advance the gusts (an Ornstein-Uhlenbeck process) and return the wind, ENU, m/s."""
        _, _, _, decay, kick = self._gains
        gauss = self._random.gauss
        g = self._gust
        self._gust = (
            decay * g[0] + kick * gauss(0.0, 1.0),
            decay * g[1] + kick * gauss(0.0, 1.0),
            decay * g[2] + 0.33 * kick * gauss(0.0, 1.0),
        )
        return self._gust

    def _move(self, dt_s: float, ax: float, ay: float, az: float) -> None:
        x, y, z = self.position
        vx, vy, vz = self.velocity
        vx, vy, vz = vx + ax * dt_s, vy + ay * dt_s, vz + az * dt_s
        speed = math.sqrt(vx * vx + vy * vy + vz * vz)
        if speed > self._frame.max_speed_mps:
            scale = self._frame.max_speed_mps / speed
            vx, vy, vz = vx * scale, vy * scale, vz * scale
        floor = max(self._floor, self._standing_m((x, y, z))) if vz <= 0.0 else self._floor
        x, y, z = x + vx * dt_s, y + vy * dt_s, z + vz * dt_s
        if z <= floor and vz <= 0.0:
            if self._highest > 0.05:  # smaller heights are the vehicle settling on its skids
                self.touchdowns.append(-vz)
            self._highest = 0.0
            side = math.hypot(vx, vy)
            keep = max(0.0, 1.0 - self._frame.floor_friction_mps2 * dt_s / side) if side > 1e-9 else 0.0
            vx, vy, vz, z = vx * keep, vy * keep, 0.0, floor
            self.on_ground = True
        else:
            self.on_ground = False
            self._highest = max(self._highest, z - self._floor)
        self.position = (x, y, z)
        self.velocity = (vx, vy, vz)
