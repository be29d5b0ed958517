"""Pose feed: sends every new, valid and recent pose to the autopilot once.

Nothing is ever repeated; without such a pose nothing is sent. Poses with wrong axes are not sent: with a height of the wrong
sign the autopilot would climb in order to land. Nor is dead reckoning sent once the pose counts as lost: the autopilot's own,
which begins from the last sound pose, does not follow an accelerometer of the camera that is off.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TypeVar

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.interfaces import Channel
from uav_recon.safety.pose_gate import PoseGate
from uav_recon.types.pose import PoseHealth, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import AXES, ReasonCode

T = TypeVar("T")

_UNSOUND = (PoseHealth.LOST, PoseHealth.WRONG)
# why a lost pose is not sent: nothing that is sure stands behind it any more; few poses are better than none
_DEAD_RECKONED = (ReasonCode.NO_POSE, ReasonCode.POSES_DISAGREE, ReasonCode.PLACE_UNSURE)


class PoseFeed:
    """Holds the newest valid pose.

    sound_s: stamp of the newest one that was neither lost nor wrong.

    ``refused`` counts the rejected poses. The reset counter that is sent increases at each restart of odom, also if the source
    did not count it, as a restarted source cannot.
    """

    def __init__(self, odom: Channel[StampedPose], link: VehicleLink, gate: PoseGate) -> None:
        self._odom = odom
        self._link = link
        self._gate = gate
        self._heard: StampedPose | None = None
        self._uncounted = 0
        self.pose: StampedPose | None = None
        self.refused = 0
        self.sound_s = -math.inf

    @property
    def lost(self) -> Reason | None:
        """Reason why the newest pose is lost, None if it is not."""
        return self._why(PoseHealth.LOST)

    @property
    def late(self) -> Reason | None:
        """Reason why the newest pose is carried on without the view, None if it is not."""
        reason = self._why(PoseHealth.DEGRADED)
        return reason if reason is not None and reason.code is ReasonCode.NO_POSE else None

    @property
    def wrong(self) -> Reason | None:
        """Reason why the newest pose is wrong, None if it is not."""
        return self._why(PoseHealth.WRONG)

    def step(self, now_s: float) -> bool:
        """Process a new pose. Return True if it restarts odom, so that all earlier data is void."""
        pose = newest(self._odom, self._heard)
        if pose is None:
            return False
        self._heard = pose
        verdict = self._gate.judge(pose, now_s)
        if not verdict.good:
            self.refused += 1
            return False
        if verdict.again and self.pose is not None:
            self._uncounted += pose.reset_counter == self.pose.reset_counter
        self.pose = pose
        self.sound_s = self.sound_s if pose.health in _UNSOUND else pose.stamp_s
        if not (self.misleads or self._is_dead_reckoned):
            self._link.feed_pose(replace(pose, reset_counter=(pose.reset_counter + self._uncounted) % 256), now_s)
        return verdict.again

    @property
    def unsure(self) -> Reason | None:
        """Reason why the source of the poses is uncertain of the place, None if it is not."""
        return None if self.pose is None else self.pose.unsure

    @property
    def misleads(self) -> bool:
        """True if an autopilot that follows the poses leaves: it lands better without any."""
        return self.wrong is not None and self.wrong.code in AXES

    @property
    def _is_dead_reckoned(self) -> bool:
        return self.lost is not None and self.lost.code in _DEAD_RECKONED

    def _why(self, health: PoseHealth) -> Reason | None:
        return self.pose.health_reason if self.pose is not None and self.pose.health is health else None


def newest(channel: Channel[T], heard: T | None) -> T | None:
    """Return the newest value if it differs from the last one received.

    A record that is being written is read the next time.
    """
    try:
        value = channel.latest()
    except ValueError:
        return None
    return None if value is heard else value
