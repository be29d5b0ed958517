"""Motion of the body by another source than the images."""

from __future__ import annotations

from typing import Protocol

from uav_recon.interfaces import Channel
from uav_recon.localization.flow.flow_odometry import FlowOdometry
from uav_recon.localization.flow.flow_samples import FlowGeometry
from uav_recon.localization.flow.measured_motion import MeasuredMotion
from uav_recon.localization.slam.gyro_alignment import GyroAlignment
from uav_recon.types.flow import FlowReadings
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose


class OutsideMotion(Protocol):
    """Carries the track through views that do not determine it.

    What it does not know is None.
    """

    def moved(self, from_s: float, to_s: float, odom_from_body: Pose) -> MeasuredMotion | None:
        """Return the motion of the body between two instants.

        odom_from_body: its attitude at the first one.
        """
        ...

    def turned(self, from_s: float, to_s: float) -> FloatArray | None:
        """Return the turn of the body between two instants, a rotation vector (3,)."""
        ...

    def attitude(self, stamp_s: float) -> Pose | None:
        """Return the attitude of the body in the tracker's odom."""
        ...

    def begin(self, gyro: GyroAlignment) -> None:
        """Take the tracker's gyro, before anything is asked."""
        ...

    def show(self, stamp_s: float, odom_from_body: Pose, sigma_m: float) -> None:
        """Take a pose of the track that is sure.

        sigma_m: rms error of its place against the one before.
        """
        ...


class NoOutsideMotion:
    """No other source."""

    def moved(self, from_s: float, to_s: float, odom_from_body: Pose) -> MeasuredMotion | None:
        """Return None."""
        return None

    def turned(self, from_s: float, to_s: float) -> FloatArray | None:
        """Return None."""
        return None

    def attitude(self, stamp_s: float) -> Pose | None:
        """Return None."""
        return None

    def begin(self, gyro: GyroAlignment) -> None:
        """Do nothing."""

    def show(self, stamp_s: float, odom_from_body: Pose, sigma_m: float) -> None:
        """Do nothing."""


class FlowMotion(NoOutsideMotion):
    """Optical flow of the autopilot and the range below.

    readings: the newest of them. begin() gives the turn by the camera's gyro.
    """

    def __init__(self, geometry: FlowGeometry, readings: Channel[FlowReadings]) -> None:
        self._geometry = geometry
        self._odometry = FlowOdometry(geometry)
        self._readings = readings

    def begin(self, gyro: GyroAlignment) -> None:
        """Take the turns of the body from the camera's gyro."""
        self._odometry = FlowOdometry(self._geometry, gyro.turned)

    def moved(self, from_s: float, to_s: float, odom_from_body: Pose) -> MeasuredMotion | None:
        """Return the motion of the body between two instants."""
        newest = self._readings.latest()
        if newest is not None:
            self._odometry.add(newest)
        return self._odometry.moved(from_s, to_s, odom_from_body)

    def show(self, stamp_s: float, odom_from_body: Pose, sigma_m: float) -> None:
        """Learn scale and delay of the flow from the track."""
        self._odometry.add_reference(stamp_s, odom_from_body, sigma_m)
