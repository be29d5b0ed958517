"""`uav-recon bench slam --recording`: trackers on real recordings.

They are compared with the reference poses of the recordings, by the conventions of evo (github.com/MichaelGrupp/evo): poses and
references are paired if their stamps differ by at most 0.01 s; ATE is the root mean square after rigid alignment, RPE that of
the relative translations over 1 s. Nothing of the recording is changed, but where an option says so.
"""

from __future__ import annotations

import dataclasses
import math
import time
from bisect import bisect_left
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from sitl.bench.slam.frame_trackers import SequenceTracker
from sitl.bench.slam.tracking_run import TrackingRun, tracking_run
from uav_recon.app.option_validation import UsageError
from uav_recon.evaluation.trajectory_error import MIN_POSES, TrajectoryError, scale_of, timed_errors_m, trajectory_error
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import StampedPose

if TYPE_CHECKING:
    from uav_recon.sensors.recordings.checked_recording import CheckedRecording
    from uav_recon.sensors.recordings.detection import ReadOptions

PAIR_S = 0.01
RPE_S = 1.0
LATE_S = 0.1  # a pose that is older is lost
GYRO_HZ = 200.0
GYRO_SPAN_S = 0.04  # a turn rate is the mean over this time: a reference that jitters by 0.05 degrees
GYRO_DENSITY = 1e-3  # rad/s per root Hz: that of a D435i on a flying vehicle
GYRO_BIAS_RADPS = 0.005
BLACK = "black"  # fault: no colour
Result = dict[str, Any]


@dataclasses.dataclass(frozen=True, eq=False)
class RecordedSequence:
    """A recording and its reference poses.

    reference_s (T,), reference (T, 4, 4): odom_from_body; empty without one. imu: samples of the recording, or a gyro made from
    the reference.
    """

    name: str
    recording: CheckedRecording
    reference_s: FloatArray
    reference: FloatArray
    imu: list[ImuSample]

    @staticmethod
    def of(folder: Path, options: ReadOptions, *, gyro: bool) -> RecordedSequence:
        """Open a recording. gyro: make one from the reference. Raises UsageError with one line."""
        from uav_recon.sensors.recordings.detection import open_recording
        from uav_recon.sensors.recordings.recording import RecordingError

        try:
            recording = open_recording(folder, options)
            poses, imu = recording.poses(), recording.imu()
        except RecordingError as error:
            raise UsageError(f"--recording {error}") from None
        stamp_s = np.array([pose.stamp_s for pose in poses])
        reference = np.array([pose.odom_from_body.matrix() for pose in poses]).reshape(-1, 4, 4)
        if gyro and len(stamp_s) < MIN_POSES:
            raise UsageError(f"--gyro reference: {folder} has {len(stamp_s)} reference poses")
        imu = reference_gyro(stamp_s, reference) if gyro else imu
        return RecordedSequence(folder.name or folder.resolve().name, recording, stamp_s, reference, imu)

    def remarks(self) -> list[str]:
        """Return what the user should know of the recording. Raises UsageError."""
        from uav_recon.app.recording_remarks import recording_remarks
        from uav_recon.sensors.recordings.recording import RecordingError

        try:
            return recording_remarks(self.recording)
        except RecordingError as error:
            raise UsageError(f"--recording {error}") from None

    def frames(self, *, black: bool) -> Iterator[Frame]:
        """Yield the frames. black: their colour is. Raises UsageError."""
        from uav_recon.sensors.recordings.recording import RecordingError

        try:
            for frame in self.recording.frames():
                yield dataclasses.replace(frame, rgb=np.zeros_like(frame.rgb)) if black else frame
        except RecordingError as error:
            raise UsageError(f"--recording {error}") from None

    def nearest(self, stamp_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the nearest reference pose (N, 4, 4) to each stamp (N,).

        With how far away it is in time (N,), s.
        """
        if not len(self.reference_s):
            return np.full((len(stamp_s), 4, 4), np.nan), np.full(len(stamp_s), math.inf)
        after = np.minimum(np.searchsorted(self.reference_s, stamp_s), len(self.reference_s) - 1)
        before = np.maximum(after - 1, 0)
        closer = stamp_s - self.reference_s[before] < self.reference_s[after] - stamp_s
        at = np.where(closer, before, after)
        return self.reference[at], np.abs(self.reference_s[at] - stamp_s)


def reference_gyro(stamp_s: FloatArray, reference: FloatArray, seed: int = 0) -> list[ImuSample]:
    """Return samples of a gyro that turns as reference poses (T, 4, 4) do.

    It has bias and noise; the specific force is not measured.
    """
    turn = Slerp(stamp_s, Rotation.from_matrix(reference[:, :3, :3]))
    at_s = np.arange(stamp_s[0] + GYRO_SPAN_S / 2, stamp_s[-1] - GYRO_SPAN_S / 2, 1.0 / GYRO_HZ)
    moved = turn(at_s - GYRO_SPAN_S / 2).inv() * turn(at_s + GYRO_SPAN_S / 2)
    random = np.random.default_rng(seed)
    rate = moved.as_rotvec() / GYRO_SPAN_S + random.uniform(-GYRO_BIAS_RADPS, GYRO_BIAS_RADPS, 3)
    rate += GYRO_DENSITY * math.sqrt(GYRO_HZ) * random.standard_normal(rate.shape)
    return [ImuSample(float(t), row, np.full(3, np.nan)) for t, row in zip(at_s, rate, strict=True)]


def track(
    tracker: SequenceTracker,
    sequence: RecordedSequence,
    *,
    black: bool = False,
    report: Callable[[int, int], None] = lambda done, total: None,
) -> TrackingRun:
    """Track a recording, as fast as the machine allows.

    report(done, total) is called after each frame.
    """
    stamps_s: list[float] = []
    answers: list[StampedPose | None] = []
    took_s: list[float] = []
    info, before = sequence.recording.info, 0
    for frame in sequence.frames(black=black):
        upto = bisect_left(sequence.imu, frame.stamp_s, key=lambda sample: sample.stamp_s)
        began_s = time.process_time()
        tracker.add_imu(sequence.imu[before:upto])
        answers.append(tracker.track(frame, info.body_from_depth))
        took_s.append(time.process_time() - began_s)
        stamps_s.append(frame.stamp_s)
        before = upto
        report(len(stamps_s), info.frames)
    return tracking_run(np.array(stamps_s), answers, took_s)


def figures(run: TrackingRun, sequence: RecordedSequence) -> Result:
    """Return the figures of a run; errors are None without a reference."""
    good = run.good
    truth, away_s = sequence.nearest(np.where(good, run.pose_stamp_s, run.stamp_s))
    judged = good & (away_s <= PAIR_S)
    error: TrajectoryError | None = None
    rpe_m = scale = None
    if judged.sum() >= MIN_POSES:
        estimate, true = run.odom_from_body[judged], truth[judged]
        error, scale = trajectory_error(estimate, true), scale_of(estimate[:, :3, 3], true[:, :3, 3])
        steps_m = timed_errors_m(estimate, true, run.pose_stamp_s[judged], RPE_S)
        rpe_m = float(np.sqrt(np.mean(steps_m**2))) if len(steps_m) else None
    stamps_s = run.stamp_s[good]
    started = len(stamps_s) > 0
    gaps_s = np.diff(np.append(stamps_s, run.stamp_s[-1])) if started else np.zeros(0)
    median_s, p95_s = np.percentile(run.took_s, (50, 95))
    return {
        "frames": len(run.stamp_s),
        "paired": int(judged.sum()),
        "duration_s": float(run.stamp_s[-1] - run.stamp_s[0]),
        "length_m": None if error is None else error.length_m,
        "ate_cm": None if error is None else 100.0 * error.ate_m,
        "ate_max_cm": None if error is None else 100.0 * error.ate_max_m,
        "rpe_cm": None if rpe_m is None else 100.0 * rpe_m,
        "rotation_deg": None if error is None else math.degrees(error.rotation_rad),
        "scale": scale,
        "first_pose_s": float(stamps_s[0] - run.stamp_s[0]) if started else None,
        "lost_s": float(np.maximum(gaps_s - LATE_S, 0.0).sum()) if started else float(run.stamp_s[-1] - run.stamp_s[0]),
        "median_ms": 1e3 * float(median_s),
        "p95_ms": 1e3 * float(p95_s),
    }
