"""Surroundings of the vehicle: known-free space, and raw depth from perception."""

from __future__ import annotations

import math

from uav_recon.autopilot.pilot.hull_geometry import HullGeometry
from uav_recon.autopilot.pilot.situation.message_validation import is_valid_free_space, is_valid_range_grid
from uav_recon.autopilot.pilot.situation.pose_feed import newest
from uav_recon.autopilot.pilot.situation.recent_poses import RecentPoses
from uav_recon.autopilot.pilot.situation.sudden_obstacle import SuddenObstacle, SuddenObstacleDetector
from uav_recon.interfaces import Channel
from uav_recon.safety.depth_age_limit import DepthInterval
from uav_recon.safety.free_space_check import FreeSpaceCheck
from uav_recon.safety.obstacle_speed_limit import ForwardDepth
from uav_recon.safety.recently_seen_space import RecentlySeenSpace
from uav_recon.types.maps import FreeSpace
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.pose import StampedPose

_FUTURE_S = 0.1  #: reject: depth stamped later than the clock by this
_BESIDE_S = 0.04  #: reject: depth farther in time from every pose: it shows neither seen space nor sudden obstacles


class Surroundings:
    """Holds the newest of both. A frame with too few returns, or an old one, is ignored.

    The near returns of an inconsistent frame still keep the vehicle away; it is ignored for anything else.
    """

    def __init__(
        self,
        free: Channel[FreeSpace],
        nearby: Channel[MinRangeGrid],
        seen_space: RecentlySeenSpace,
        hull: HullGeometry,
    ) -> None:
        self._free = free
        self._nearby = nearby
        self._seen_space = seen_space
        self._hull = hull
        self._free_received: FreeSpace | None = None
        self._min_ranges_received: MinRangeGrid | None = None
        self.known_free: FreeSpaceCheck | None = None
        self.ahead: ForwardDepth | None = None
        self._consistent_s = -math.inf
        self._neighbourhood = SuddenObstacleDetector()
        self._past = RecentPoses()
        self._interval = DepthInterval()
        self.sudden_obstacle: SuddenObstacle | None = None  # in the newest valid frame

    def step(self, pose: StampedPose | None, now_s: float) -> None:
        """Read what is new. Raises nothing: an invalid record is ignored.

        A frame comes tenths of a second late, so it is used with the pose at its stamp.
        """
        self._past.add(pose, now_s)
        free = newest(self._free, self._free_received)
        if free is not None:
            self._free_received = free
            if is_valid_free_space(free):
                self.known_free = FreeSpaceCheck(free, self._hull.vehicle_radius_m, self._hull.vehicle_height_m)
        nearby = newest(self._nearby, self._min_ranges_received)
        self._min_ranges_received = nearby or self._min_ranges_received
        if (
            nearby is None
            or not (is_valid_range_grid(nearby) and ForwardDepth.has_enough_returns(nearby))
            or not nearby.stamp_s <= now_s + _FUTURE_S
        ):
            return
        if self.ahead is None or nearby.stamp_s > self.ahead.stamp_s:
            self._interval.add(nearby.stamp_s, now_s)
            self.ahead = ForwardDepth(nearby, self._hull.vehicle_radius_m)
            self._consistent_s = nearby.stamp_s if nearby.consistent else self._consistent_s
            then = self._past.at(nearby.stamp_s, _BESIDE_S)
            if then is not None and nearby.consistent:
                self._seen_space.add(nearby, then.odom_from_body)
                self.sudden_obstacle = self._neighbourhood.look(nearby, then.odom_from_body)

    @property
    def ghost_s(self) -> float:
        """Time at which the camera last showed an obstacle where nothing stands."""
        return self._neighbourhood.ghost_s

    def forget(self) -> None:
        """Forget everything after a jump of odom: what was seen and mapped before is elsewhere now."""
        self.known_free = None
        self._neighbourhood.forget()
        self._past.forget()
        self.sudden_obstacle = None

    @property
    def one_missing_s(self) -> float:
        """Age of depth (s) that one missing frame causes, 0 while the camera's rate is not known."""
        return self._interval.one_missing_s

    def depth_age_s(self, now_s: float) -> float:
        """Return the age (s) of the newest valid frame with enough returns, infinity for none."""
        return now_s - self._consistent_s

    def rejects_depth(self, now_s: float, within_s: float) -> bool:
        """Return True if frames came within this time, and the newest one is inconsistent.

        Only frames with enough returns count.
        """
        return self.ahead is not None and self.ahead.stamp_s > self._consistent_s and now_s - self.ahead.stamp_s <= within_s
