"""True trajectory of a firmware's vehicle: its reports, in the world frame at any time."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from sitl.geometry.ned_frd import frd_from_flu, ned_frd_from_enu_flu, ned_from_enu
from sitl.geometry.quaternion import (
    IDENTITY,
    Quat,
    Vec3,
    conjugate,
    from_small_rotation,
    from_yaw,
    multiply,
    normalised,
    rotate,
    yaw_of,
)
from sitl.world.quadrotor import GRAVITY_MPS2

_LONGEST_S = 0.1  # longest extrapolation of a reading
_SLOPE_S = 0.05  # time between velocities for an acceleration: with steps of 1 cm/s its error is 0.2 m/s^2
_STILL: Vec3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Reading:
    """One report of the truth: latitude and longitude (1e-7 deg), height (m), velocity (m/s)."""

    latitude_e7: int
    longitude_e7: int
    height_m: float
    velocity_ned: Vec3
    ned_from_frd: Quat


@dataclass(frozen=True, slots=True)
class Inertial:
    """Angular rates (rad/s) and specific force (m/s^2) at the body's centre, FRD.

    specific_force_frd None: derived from velocities.
    """

    gyro_frd: Vec3
    specific_force_frd: Vec3 | None


@dataclass(frozen=True, slots=True)
class PositionResolution:
    """Resolution of a firmware's positions: metres per 1e-7 deg of latitude, height step (m)."""

    metres_per_e7: float
    height_step_m: float


@dataclass(frozen=True, slots=True)
class TrueMotion:
    """True position (m) and velocity (m/s) in the world, world_from_body, and IMU values (FLU)."""

    position: Vec3
    velocity: Vec3
    quat_wxyz: Quat
    gyro: Vec3
    specific_force: Vec3


class TrueTrajectory:
    """True trajectory from readings with a position resolution of about 1 cm.

    Velocities have a finer resolution. Therefore the position is integrated from them, and kept within one step of the last
    reading. The first reading is on the pad: its position becomes the world's origin, and its heading the scene's.
    """

    def __init__(self, grain: PositionResolution, start_yaw_rad: float) -> None:
        """Create an empty trajectory.

        start_yaw_rad: heading on the pad, counter-clockwise from the world's first axis.
        """
        self._grain = grain
        self._start_yaw_rad = start_yaw_rad
        self._pad: Reading | None = None
        self._turn: Quat = IDENTITY  # world_from_enu
        self._stamp_s = -math.inf
        self._position: Vec3 = (0.0, 0.0, 0.0)
        self._velocity: Vec3 = (0.0, 0.0, 0.0)
        self._quat: Quat = IDENTITY
        self._felt = Inertial((0.0, 0.0, 0.0), None)
        self._velocities: deque[tuple[float, Vec3]] = deque()

    @property
    def begun(self) -> bool:
        """True after the first reading."""
        return self._pad is not None

    def set_inertial(self, felt: Inertial) -> None:
        """Set the present angular rates and specific force."""
        self._felt = felt

    def take(self, stamp_s: float, reading: Reading) -> None:
        """Add a reading of stamp_s; one older than the last is ignored.

        Raises ZeroDivisionError for a zero attitude quaternion.
        """
        if stamp_s < self._stamp_s:
            return
        enu_from_flu = normalised(ned_frd_from_enu_flu(reading.ned_from_frd))  # the conversion is its own inverse
        if self._pad is None:
            self._pad = reading
            self._turn = from_yaw(self._start_yaw_rad - yaw_of(enu_from_flu))
        velocity = rotate(self._turn, ned_from_enu(reading.velocity_ned))
        carried = self._carried(stamp_s, velocity)
        self._position = self._near(carried, self._pad, reading)
        self._stamp_s = stamp_s
        self._velocity = velocity
        self._quat = multiply(self._turn, enu_from_flu)
        self._velocities.append((stamp_s, velocity))
        while self._velocities[0][0] < stamp_s - _SLOPE_S:
            self._velocities.popleft()

    def at(self, now_s: float) -> TrueMotion:
        """Return the motion at now_s, extrapolated from the last reading by at most 0.1 s."""
        ahead_s = min(max(now_s - self._stamp_s, 0.0), _LONGEST_S)
        gyro, felt = frd_from_flu(self._felt.gyro_frd), self._felt.specific_force_frd
        p, v = self._position, self._velocity
        return TrueMotion(
            (p[0] + v[0] * ahead_s, p[1] + v[1] * ahead_s, p[2] + v[2] * ahead_s), v,
            multiply(self._quat, from_small_rotation(gyro[0] * ahead_s, gyro[1] * ahead_s, gyro[2] * ahead_s)),
            gyro, self._force() if felt is None else frd_from_flu(felt),
        )  # fmt: skip

    def _force(self) -> Vec3:
        """Return the specific force (FLU, m/s^2) from the latest change of velocity."""
        (first_s, a), (last_s, b) = (self._velocities[0], self._velocities[-1]) if self._velocities else ((0.0, _STILL),) * 2
        dt_s = max(last_s - first_s, 1e-3)
        force = ((b[0] - a[0]) / dt_s, (b[1] - a[1]) / dt_s, (b[2] - a[2]) / dt_s + GRAVITY_MPS2)
        return rotate(conjugate(self._quat), force)

    def _carried(self, stamp_s: float, velocity: Vec3) -> Vec3:
        dt_s = stamp_s - self._stamp_s if math.isfinite(self._stamp_s) else 0.0
        p, v, w = self._position, self._velocity, velocity
        half_s = 0.5 * dt_s
        return (p[0] + (v[0] + w[0]) * half_s, p[1] + (v[1] + w[1]) * half_s, p[2] + (v[2] + w[2]) * half_s)

    def _near(self, carried: Vec3, pad: Reading, reading: Reading) -> Vec3:
        """Return the position `carried`, limited to one step from the reading.

        The limits apply along the firmware's axes (ENU).
        """
        north_step = self._grain.metres_per_e7
        east_step = north_step * math.cos(math.radians(pad.latitude_e7 * 1e-7))
        read = (
            (reading.longitude_e7 - pad.longitude_e7) * east_step,
            (reading.latitude_e7 - pad.latitude_e7) * north_step,
            reading.height_m - pad.height_m,
        )
        steps = (east_step, north_step, self._grain.height_step_m)
        back = rotate((self._turn[0], -self._turn[1], -self._turn[2], -self._turn[3]), carried)
        held = [min(max(b, r - s), r + s) for b, r, s in zip(back, read, steps, strict=True)]
        return rotate(self._turn, (held[0], held[1], held[2]))
