"""True state of the vehicle as a human pilot sees it, in place of the estimate. NED and FRD."""

from __future__ import annotations

from sitl.geometry.ned_frd import ned_frd_from_enu_flu, ned_from_enu
from sitl.geometry.quaternion import Quat, Vec3, yaw_of
from sitl.world.quadrotor import Quadrotor


class PilotView:
    """Replacement for the estimator after a reboot in flight: the true state."""

    horizontal_valid = True

    def __init__(self, vehicle: Quadrotor) -> None:
        self._vehicle = vehicle

    @property
    def position(self) -> Vec3:
        """Position, local NED, m."""
        return ned_from_enu(self._vehicle.position)

    @property
    def velocity(self) -> Vec3:
        """Velocity, local NED, m/s."""
        return ned_from_enu(self._vehicle.velocity)

    @property
    def height_rate(self) -> float:
        """Vertical velocity, m/s, down."""
        return self.velocity[2]

    @property
    def acceleration(self) -> Vec3:
        """Zero: a human pilot does not perceive the acceleration."""
        return (0.0, 0.0, 0.0)

    @property
    def quat_wxyz(self) -> Quat:
        """Attitude ned_from_frd."""
        return ned_frd_from_enu_flu(self._vehicle.quat_wxyz)

    @property
    def yaw(self) -> float:
        """Heading, rad."""
        return yaw_of(self.quat_wxyz)
