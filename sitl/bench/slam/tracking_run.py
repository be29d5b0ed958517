"""One tracker over one sequence: poses, quality and processor time of each frame."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sitl.bench.slam.frame_trackers import SequenceTracker
from uav_recon.sensors.stream_camera import depth_lookup_table
from uav_recon.types.camera import Frame, ImuSample, Intrinsics
from uav_recon.types.frames import BoolArray, FloatArray, IntArray
from uav_recon.types.pose import Pose, StampedPose

if TYPE_CHECKING:
    from sitl.apps.rgbd_sequences import RgbdSequence

DEPTH_RANGE_M = (0.3, 6.0)


@dataclass(frozen=True, eq=False)
class TrackingRun:
    """Answers of a tracker to N frames.

    stamp_s (N,): of the frames. quality (N,): 0 = lost, of None too. answered (N,): there was a pose. pose_stamp_s (N,),
    odom_from_body (N, 4, 4): of the pose; NaN without one. place_covariance (N, 3, 3): that the tracker claims, m².
    took_s (N,): processor time.
    """

    stamp_s: FloatArray
    quality: IntArray
    answered: BoolArray
    pose_stamp_s: FloatArray
    odom_from_body: FloatArray
    place_covariance: FloatArray
    took_s: FloatArray

    @property
    def good(self) -> BoolArray:
        """Frames (N,) with a pose that the tracker reports as valid."""
        return self.answered & (self.quality > 0)


def run(
    tracker: SequenceTracker, sequence: RgbdSequence, report: Callable[[int, int], None] = lambda done, total: None
) -> TrackingRun:
    """Track a sequence as in flight: a frame comes with the samples that arrived before it.

    report(done, total) is called after each frame.
    """
    samples = [ImuSample(float(row[0]), row[1:4], row[4:7]) for row in sequence.imu]
    upto = np.searchsorted(sequence.imu[:, 0], sequence.arrival_s, side="right").tolist()
    answers: list[StampedPose | None] = []
    took_s, before = [], 0
    frames = SequenceFrames(sequence)
    for number in range(len(frames)):
        frame = frames[number]
        body_from_depth = Pose.from_matrix(sequence.body_from_depth[number])
        began_s = time.process_time()
        tracker.add_imu(samples[before : upto[number]])
        answers.append(tracker.track(frame, body_from_depth))
        took_s.append(time.process_time() - began_s)
        before = upto[number]
        report(number + 1, len(sequence.stamp_s))
    return tracking_run(sequence.stamp_s, answers, took_s)


class SequenceFrames:
    """Frames of a sequence as the product's camera makes them, converted one at a time."""

    def __init__(self, sequence: RgbdSequence) -> None:
        self._sequence = sequence
        self._table = depth_lookup_table(*DEPTH_RANGE_M)
        depth, rgb = sequence.header.depth, sequence.header.rgb
        self._depth, self._rgb = (Intrinsics(s.fx, s.fy, s.cx, s.cy, s.width, s.height) for s in (depth, rgb))
        values = np.array(sequence.header.rgb_from_depth)
        self._rgb_from_depth = Pose(values[:4], values[4:])

    def __len__(self) -> int:
        return len(self._sequence.stamp_s)

    def __getitem__(self, number: int) -> Frame:
        s = self._sequence
        depth_m = self._table[s.depth_mm[number]]
        return Frame(float(s.stamp_s[number]), number, depth_m, self._depth, s.rgb[number], self._rgb, self._rgb_from_depth)


def tracking_run(stamp_s: FloatArray, answers: list[StampedPose | None], took_s: list[float]) -> TrackingRun:
    """Return the run of answers to frames with stamps (N,)."""
    count = len(answers)
    poses, pose_stamp_s = np.full((count, 4, 4), np.nan), np.full(count, np.nan)
    covariance, quality = np.full((count, 3, 3), np.nan), np.zeros(count, np.int64)
    for number, answer in enumerate(answers):
        if answer is not None:
            poses[number], pose_stamp_s[number] = answer.odom_from_body.matrix(), answer.stamp_s
            covariance[number] = answer.covariance[:3, :3]
            quality[number] = answer.quality
    return TrackingRun(stamp_s, quality, np.isfinite(pose_stamp_s), pose_stamp_s, poses, covariance, np.array(took_s))
