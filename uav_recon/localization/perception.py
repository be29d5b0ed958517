"""Perception's step: inertial samples and late poses in, steady odometry and posed frames out."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

from uav_recon.clock import RateKeeper
from uav_recon.interfaces import Channel, Clock, DepthCamera, PoseSource
from uav_recon.localization import error_propagation, min_range_binning, planar_patches
from uav_recon.localization.camera_mount import Mount
from uav_recon.localization.depth_consistency import DepthConsistencyMonitor
from uav_recon.localization.fusion_filter import FusionFilter
from uav_recon.localization.min_range_binning import nearest_in_cells
from uav_recon.types.camera import Frame, PosedFrame
from uav_recon.types.min_range_grid import MinRangeGrid
from uav_recon.types.pose import Pose, PoseHealth, StampedPose

_WAITING_FRAMES = 4  # at 15 Hz more than the longest wait


class Perception:
    """Holds the order of things; call step() at about 100 Hz. One step costs about 1 ms and never blocks.

    Odometry is published at rate_hz, stamped now, with its health and odom's place in the world. When no pose came for the
    filter's pose_lost_s, a last one with quality 0 is published and then none, until poses come again. A frame waits until a
    pose at or after its stamp was fused, or frame_wait_s; one whose own pose is not known is dropped, so is one that is not
    believed, and one that is not newer than all before it: it was mapped, or its place is gone. What is near in a frame is
    published at once, pose or no pose, believed or not. Odometry that depth contradicts is wrong: the quality stays, for it
    is better than none to land by. ``published_odom``, ``published_frames`` and ``dropped_frames`` count.
    """

    def __init__(
        self,
        camera: DepthCamera,
        poses: PoseSource,
        fusion: FusionFilter,
        mount: Mount,
        odom: Channel[StampedPose],
        frames: Channel[PosedFrame],
        nearby: Channel[MinRangeGrid],
        clock: Clock,
        rate_hz: float = 30.0,
        frame_wait_s: float = 0.2,
    ) -> None:
        self._camera, self._poses, self._fusion, self._mount = camera, poses, fusion, mount
        self._odom, self._frames, self._nearby = odom, frames, nearby
        self._clock, self._frame_wait_s = clock, frame_wait_s
        self._credence = DepthConsistencyMonitor()
        warm_up()
        self._rate = RateKeeper(rate_hz, clock.now_s())
        self._waiting: deque[Frame] = deque()
        self._newest_frame_s = -math.inf  # never later than now: no stamp of another clock can shut out those after it
        self._said_lost = True
        self.published_odom = self.published_frames = self.dropped_frames = 0

    def step(self) -> None:
        """Read what came, publish what is due."""
        now_s = self._clock.now_s()
        self._mount.observe()
        self._fusion.add_imu(self._camera.imu(), self._clock.now_s())  # read before the clock: none is of a time to come
        for pose in self._poses.poses():
            self._fusion.add_pose(pose, now_s)
        if self._rate.due(now_s):
            self._publish_odom(now_s)
        self._take_frame(now_s)
        self._publish_frame(now_s)

    def _publish_odom(self, now_s: float) -> None:
        estimate = self._fusion.odom_at(now_s)
        if estimate is None or (estimate.quality == 0 and self._said_lost):
            return
        drift = self._credence.drift(now_s)
        if drift:
            estimate = replace(estimate, health=PoseHealth.WRONG, why=drift)
        self._odom.publish(estimate)
        self.published_odom += 1
        self._said_lost = estimate.quality == 0

    def _take_frame(self, now_s: float) -> None:
        frame = self._camera.poll()
        if frame is None:
            return
        timely = now_s - 1.0 <= frame.stamp_s <= now_s + 0.01
        if not (timely and frame.stamp_s > self._newest_frame_s):
            self.dropped_frames += 1
            return
        self._newest_frame_s = frame.stamp_s
        body_from_depth = self._mount.body_from_depth(frame.stamp_s)
        if body_from_depth is not None:
            believed = self._believes(frame, body_from_depth)
            self._nearby.publish(nearest_in_cells(frame, body_from_depth, believed))
            if not believed:
                self.dropped_frames += 1
                return
        if len(self._waiting) == _WAITING_FRAMES:
            self._waiting.popleft()
            self.dropped_frames += 1
        self._waiting.append(frame)

    def _believes(self, frame: Frame, body_from_depth: Pose) -> bool:
        """As far as it can be told: with the pose carried on to the frame, for its own comes later."""
        estimate = self._fusion.odom_at(frame.stamp_s)
        if estimate is None or estimate.quality == 0:
            return True
        return self._credence.believes(frame, estimate.odom_from_body @ body_from_depth, estimate.reset_counter)

    def _publish_frame(self, now_s: float) -> None:
        """At most one frame a step: a reader of a last-value channel would miss the first of two."""
        if not self._waiting:
            return
        frame = self._waiting[0]
        if self._fusion.newest_pose_s < frame.stamp_s and now_s - frame.stamp_s < self._frame_wait_s:
            return
        self._waiting.popleft()
        estimate = self._fusion.odom_at(frame.stamp_s)
        body_from_depth = self._mount.body_from_depth(frame.stamp_s)
        if estimate is None or estimate.quality == 0 or body_from_depth is None:
            self.dropped_frames += 1
            return
        # maps live in odom, which never jumps: what is near fits what was mapped a moment ago, whatever the source corrects.
        # The mission would have to re-pose its keyframes by estimate.correction before it could map in the world.
        self._frames.publish(PosedFrame(frame, estimate.odom_from_body @ body_from_depth, estimate.map_epoch))
        self.published_frames += 1


def warm_up() -> None:
    """Compile every kernel of perception."""
    for part in (DepthConsistencyMonitor, planar_patches, error_propagation, min_range_binning):
        part.warm_up()
