"""A one-axis camera gimbal driven by PX4 (gimbal protocol v2)."""

from __future__ import annotations

import math

_RATE_RADPS = math.radians(60.0)


class Gimbal:
    """Gimbal with angle and rate limits that obeys its primary controller only.

    Pitch is relative to the body, rad, positive up as in MAVLink.
    """

    def __init__(self, lowest_rad: float, highest_rad: float) -> None:
        self._lowest = lowest_rad
        self._highest = highest_rad
        self._wanted = 0.0
        self._rate = 0.0
        self.owner = (0, 0)
        self.pitch = 0.0
        self.pitch_rate = 0.0

    def configure(self, system: int, component: int) -> None:
        """Give primary control to the MAVLink sender (system, component)."""
        self.owner = (system, component)

    def command(self, sender: tuple[int, int], pitch: float, pitch_rate: float) -> bool:
        """Set the wanted pitch (rad), or the wanted rate (rad/s) if pitch is NaN.

        Returns False, without effect, if the sender does not own the gimbal.
        """
        if sender != self.owner:
            return False
        if math.isfinite(pitch):
            self._wanted = min(max(pitch, self._lowest), self._highest)
            self._rate = 0.0
        elif math.isfinite(pitch_rate):
            self._rate = min(max(pitch_rate, -_RATE_RADPS), _RATE_RADPS)
        return True

    def step(self, dt_s: float) -> None:
        """Move towards the wanted pitch for dt_s seconds, at 60 deg/s at most."""
        if self._rate:
            self._wanted = min(max(self._wanted + self._rate * dt_s, self._lowest), self._highest)
        move = min(max(self._wanted - self.pitch, -_RATE_RADPS * dt_s), _RATE_RADPS * dt_s)
        self.pitch += move
        self.pitch_rate = move / dt_s
