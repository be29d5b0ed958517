"""What a pilot on the sticks goes by: the vehicle itself, not what the autopilot makes of it. Local NED and FRD."""

from __future__ import annotations

from sitl.geometry.ned_frd import ned_frd_from_enu_flu, ned_from_enu
from sitl.geometry.quaternion import Quat, Vec3, yaw_of
from sitl.world.quadrotor import Quadrotor


class PilotView:
    """Stands in for an estimator that has just begun anew."""

    horizontal_valid = True

    def __init__(self, vehicle: Quadrotor) -> None:
        self._vehicle = vehicle

    @property
    def position(self) -> Vec3:
        """Metres."""
        return ned_from_enu(self._vehicle.position)

    @property
    def velocity(self) -> Vec3:
        """Metres a second."""
        return ned_from_enu(self._vehicle.velocity)

    @property
    def acceleration(self) -> Vec3:
        """Nobody sees it."""
        return (0.0, 0.0, 0.0)

    @property
    def quat_wxyz(self) -> Quat:
        """Attitude ned_from_frd."""
        return ned_frd_from_enu_flu(self._vehicle.quat_wxyz)

    @property
    def yaw(self) -> float:
        """Heading, rad."""
        return yaw_of(self.quat_wxyz)
