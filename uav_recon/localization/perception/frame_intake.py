"""Intake of depth frames: stamps, the two queues in which they wait, counts of dropped ones."""

from __future__ import annotations

import math
from collections import Counter, deque

from uav_recon.interfaces import DepthCamera
from uav_recon.types.camera import Frame
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_OLDEST_FRAME_S = 1.0  #: reject: an older frame
_FUTURE_S = 0.01  #: reject: a frame stamped later than the clock by this
_WAITING_FRAMES = 4  #: reject: the oldest of more frames that wait for a pose: at 15 Hz this is more than the longest wait
_ANGLE_WAIT_S = 0.08  #: internal: a frame waits for the angle of the camera's mount at its stamp, not for longer


class FrameIntake:
    """Frames of the camera in the order of their stamps, until their poses are known.

    A frame waits for the angle of the mount at its stamp, and once it is accepted for a pose at or after its stamp, but not
    longer than pose_wait_s.

    ``dropped``: counts by reason. ``newest_drop``: (s, reason) of the newest one; None before the first.
    """

    def __init__(self, camera: DepthCamera, pose_wait_s: float) -> None:
        self._camera = camera
        self._pose_wait_s = pose_wait_s
        self._newest_s = -math.inf  # never later than now: no stamp of another clock can block the frames after it
        self._unmeasured: deque[Frame] = deque()  # wait for the angle of the mount
        self._unplaced: deque[Frame] = deque()  # wait for a pose
        self.dropped: Counter[ReasonCode] = Counter()
        self.newest_drop: tuple[float, Reason | None] = -math.inf, None

    def admit(self, now_s: float) -> Frame | None:
        """Read the camera. Return its frame if the stamp is possible and newer than all before."""
        frame = self._camera.poll()
        if frame is None:
            return None
        timely = now_s - _OLDEST_FRAME_S <= frame.stamp_s <= now_s + _FUTURE_S
        if not (timely and frame.stamp_s > self._newest_s):
            self.drop(now_s, Reason(ReasonCode.DEPTH_FRAME_STAMP))
            return None
        self._newest_s = frame.stamp_s
        self._unmeasured.append(frame)
        return frame

    def next_measured(self, now_s: float, measured_until_s: float) -> Frame | None:
        """Remove the oldest admitted frame once the mount's angle is measured at its stamp."""
        if self._unmeasured and self._unmeasured[0].stamp_s <= max(measured_until_s, now_s - _ANGLE_WAIT_S):
            return self._unmeasured.popleft()
        return None

    def accept(self, now_s: float, frame: Frame) -> None:
        """Let a frame wait for its pose. Of too many, the oldest is dropped."""
        if len(self._unplaced) == _WAITING_FRAMES:
            self._unplaced.popleft()
            self.drop(now_s, Reason(ReasonCode.DEPTH_FRAME_UNPLACED))
        self._unplaced.append(frame)

    def next_placed(self, now_s: float, newest_pose_s: float) -> Frame | None:
        """Remove the oldest accepted frame once a pose at or after it is fused, or its wait is over."""
        if not self._unplaced:
            return None
        stamp_s = self._unplaced[0].stamp_s
        if newest_pose_s < stamp_s and now_s - stamp_s < self._pose_wait_s:
            return None
        return self._unplaced.popleft()

    def drop(self, now_s: float, reason: Reason) -> None:
        """Count a frame that is not given on."""
        self.dropped[reason.code] += 1
        self.newest_drop = now_s, reason
