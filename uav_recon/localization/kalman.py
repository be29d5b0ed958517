"""A Kalman filter for three axes that share one covariance: position, velocity and acceleration offset of each.

Nothing here tells one axis from another (the same process noise, one variance for a position), so the (9, 9) covariance of
all of them is one symmetric (3, 3) matrix for every axis, and plain floats do in microseconds what matrices do in hundreds.
"""

from __future__ import annotations

from typing import NamedTuple


class Spread(NamedTuple):
    """Covariance of one axis: p position (m), v velocity (m/s), b acceleration offset (m/s²)."""

    pp: float
    pv: float
    pb: float
    vv: float
    vb: float
    bb: float

    def carried(self, dt_s: float, acceleration: float, offset: float) -> Spread:
        """After dt_s of constant acceleration offset: F P Fᵀ + Q, F = [[1, dt, dt²/2], [0, 1, dt], [0, 0, 1]].

        Q integrates white acceleration noise (m/s² per root Hz) and a random walk of its offset (m/s² per root second).
        """
        dt, half = dt_s, 0.5 * dt_s * dt_s
        a, b = acceleration * acceleration, offset * offset
        to_v, to_b = self.pv + dt * self.vv + half * self.vb, self.pb + dt * self.vb + half * self.bb
        vb = self.vb + dt * self.bb
        return Spread(
            self.pp + dt * self.pv + half * self.pb + dt * to_v + half * to_b + a * dt**3 / 3 + b * dt**5 / 20,
            to_v + dt * to_b + a * half + b * dt**4 / 8,
            to_b + b * dt**3 / 6,
            self.vv + dt * self.vb + dt * vb + a * dt + b * dt**3 / 3,
            vb + b * half,
            self.bb + b * dt,
        )

    def gains(self, variance_m2: float) -> tuple[float, float, float]:
        """What of a position's innovation goes to position, velocity and offset."""
        scale = 1.0 / (self.pp + variance_m2)
        return (self.pp * scale, self.pv * scale, self.pb * scale)

    def corrected(self, variance_m2: float) -> Spread:
        """After a position of this variance: P - K S Kᵀ."""
        _, to_v, to_b = self.gains(variance_m2)
        left = variance_m2 / (self.pp + variance_m2)
        return Spread(
            self.pp * left,
            self.pv * left,
            self.pb * left,
            self.vv - to_v * self.pv,
            self.vb - to_v * self.pb,
            self.bb - to_b * self.pb,
        )

    def offset_unknown(self) -> Spread:
        """With the acceleration offset forgotten."""
        return self._replace(pb=0.0, vb=0.0, bb=1.0)
