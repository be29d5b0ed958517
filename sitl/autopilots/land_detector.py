"""Land detector: landed if the commanded force points down and the vehicle does not move."""

from __future__ import annotations

import math

from sitl.geometry.quaternion import Vec3
from sitl.world.quadrotor import GRAVITY_MPS2


class LandDetector:
    """Land detector. `landed` is initially True, and again after after_s at rest unless `blind`."""

    def __init__(self, after_s: float) -> None:
        self._after_s = after_s
        self._resting_s = 0.0
        self.landed = True
        self.blind = False

    def touched_down(self, dt_s: float, force: Vec3, velocity: Vec3, level_known: bool) -> bool:
        """Advance by dt_s; return True if a landing was detected in this step.

        force: wanted specific force, local NED, m/s^2. velocity: local NED, m/s. level_known: the horizontal velocity is
        valid; an invalid one does not prevent the detection (from PX4's sources).
        """
        if self.landed:
            return False
        pressed = force[2] + GRAVITY_MPS2 > 0.8
        still = abs(velocity[2]) < 0.15 and (not level_known or math.hypot(velocity[0], velocity[1]) < 0.5)
        self._resting_s = self._resting_s + dt_s if pressed and still else 0.0
        self.landed = self._resting_s >= self._after_s and not self.blind
        return self.landed

    def lifted(self) -> None:
        """Set the state to flying."""
        self.landed = False

    def rest(self) -> None:
        """Set the state to landed: motors idle or off."""
        self.landed = True
        self._resting_s = 0.0
