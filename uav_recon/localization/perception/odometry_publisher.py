"""Publisher of odometry: at a fixed rate, with its health, and once when it is lost."""

from __future__ import annotations

from dataclasses import replace

from uav_recon.clock import RateKeeper
from uav_recon.interfaces import Channel
from uav_recon.localization.perception.fused_odometry import FusedOdometry
from uav_recon.localization.perception.sensor_checks import SensorChecks
from uav_recon.types.pose import PoseHealth, StampedPose


class OdometryPublisher:
    """Publishes corrected odometry, stamped now, at the rate of its keeper.

    Odometry that depth contradicts has health WRONG; its quality stays, because it is better than none for landing. Lost
    odometry (quality 0) is published once, and then none until poses arrive again. ``published``: a count.
    """

    def __init__(self, channel: Channel[StampedPose], rate: RateKeeper) -> None:
        self._channel = channel
        self._rate = rate
        self._lost_published = True
        self.published = 0

    def step(self, now_s: float, odometry: FusedOdometry, checks: SensorChecks) -> None:
        """Publish what is due."""
        if not self._rate.due(now_s):
            return
        estimate = odometry.corrected(now_s)
        if estimate is None or (estimate.quality == 0 and self._lost_published):
            return
        fault = checks.fault(now_s)
        if fault is not None:
            estimate = replace(estimate, health=PoseHealth.WRONG, health_reason=fault)
        self._channel.publish(estimate)
        self.published += 1
        self._lost_published = estimate.quality == 0
