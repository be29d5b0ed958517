"""Figures of one tracked sequence: errors, lost frames, reactions to faults, processor time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from sitl.bench.slam.tracking_run import TrackingRun
from uav_recon.evaluation.trajectory_error import MIN_POSES, TrajectoryError, aligned, trajectory_error
from uav_recon.types.frames import BoolArray, FloatArray
from uav_recon.types.pose import Pose

if TYPE_CHECKING:
    from sitl.apps.rgbd_sequences import RgbdSequence
    from sitl.apps.sequence_faults import FaultWindow

CLAIMED_SHARE = 0.95
GROSS_M = 0.3  # a pose with a larger error may not be reported as good


@dataclass(frozen=True)
class FaultReaction:
    """Reaction to one window of a fault.

    begin_s: of the window, from the start of the sequence. reported_s: from the onset to the first frame that is reported
    lost, None if none is before the window ends. false_good_s: time, from the onset to the next onset or the end, in which
    the pose is reported good with an error above GROSS_M. back_s: from the end of the window to the first good pose with an
    error of at most GROSS_M, None if there is none before the next onset.
    """

    begin_s: float
    reported_s: float | None
    false_good_s: float
    back_s: float | None


@dataclass(frozen=True)
class TrackingFigures:
    """Figures of one sequence.

    error: of the good poses outside the windows of a fault; None with fewer than MIN_POSES. lost: share of the frames after
    the first pose, outside the windows, that are lost. first_pose_s: from the first frame to the first pose. false_good:
    share of all frames whose pose is reported good with an error above GROSS_M. within_claimed: share of the good poses outside
    the windows whose place is within the region that the tracker claims for CLAIMED_SHARE of them; None as error. median_ms,
    p95_ms: processor time of a frame.
    """

    error: TrajectoryError | None
    frames: int
    lost: float
    first_pose_s: float | None
    false_good: float
    within_claimed: float | None
    median_ms: float
    p95_ms: float
    reactions: tuple[FaultReaction, ...]


def figures_of(run: TrackingRun, sequence: RgbdSequence, windows: list[FaultWindow]) -> TrackingFigures:
    """Return the figures of a run; windows: of the fault, none if there is none or if it lasts.

    A pose is compared with the truth at its own stamp.
    """
    good, stamp_s = run.good, run.stamp_s
    truth = sequence.true_body_at(np.where(good, run.pose_stamp_s, stamp_s))
    outside = np.ones(len(stamp_s), np.bool_)
    for window in windows:
        outside &= (stamp_s < window.begin_s) | (stamp_s >= window.end_s)
    judged = good & outside
    error = trajectory_error(run.odom_from_body[judged], truth[judged]) if judged.sum() >= MIN_POSES else None
    gross = _gross(run, truth, stamp_s < windows[0].begin_s if windows else outside)
    started = int(np.argmax(good)) if good.any() else None
    after = outside & (np.arange(len(stamp_s)) >= (started or 0))
    median_s, p95_s = np.percentile(run.took_s, (50, 95))
    return TrackingFigures(
        error=error,
        frames=len(stamp_s),
        lost=float((~good[after]).mean()) if after.any() else 1.0,
        first_pose_s=None if started is None else float(stamp_s[started] - stamp_s[0]),
        false_good=float(gross.mean()),
        within_claimed=within_claimed(run, truth, judged) if judged.sum() >= MIN_POSES else None,
        median_ms=1e3 * float(median_s),
        p95_ms=1e3 * float(p95_s),
        reactions=reactions(stamp_s, good, gross, windows),
    )


def within_claimed(run: TrackingRun, truth: FloatArray, judged: BoolArray) -> float:
    """Return the share of places that lie within their claimed ellipsoids of CLAIMED_SHARE.

    truth (N, 4, 4): true poses. judged (N,): frames that count. Place and heading are compared from the first pose on.
    """
    first = Pose.from_matrix(truth[run.good][0]) @ Pose.from_matrix(run.odom_from_body[run.good][0]).inverse()
    world_from_odom = Pose.from_yaw(first.yaw_rad(), np.zeros(3))
    places_m, true_m = world_from_odom.apply(run.odom_from_body[:, :3, 3]), truth[:, :3, 3]
    off_m = (places_m - true_m) - (places_m - true_m)[run.good][0]
    turn = world_from_odom.rotation()
    claimed = turn @ run.place_covariance[judged] @ turn.T
    distance2 = np.einsum("ni,ni->n", off_m[judged], np.linalg.solve(claimed, off_m[judged][..., None])[..., 0])
    return float((distance2 <= chi2.ppf(CLAIMED_SHARE, 3)).mean())


def reactions(stamp_s: FloatArray, good: BoolArray, gross: BoolArray, windows: list[FaultWindow]) -> tuple[FaultReaction, ...]:
    """Return the reaction to each window.

    stamp_s (N,), good (N,): reported good. gross (N,): reported good with an error above GROSS_M.
    """
    ends = [*(window.begin_s for window in windows), np.inf][1:]
    period_s = np.diff(stamp_s, append=stamp_s[-1])
    return tuple(_reaction(stamp_s, good, gross, period_s, window, end_s) for window, end_s in zip(windows, ends, strict=True))


def _reaction(
    stamp_s: FloatArray, good: BoolArray, gross: BoolArray, period_s: FloatArray, window: FaultWindow, end_s: float
) -> FaultReaction:
    inside = (stamp_s >= window.begin_s) & (stamp_s < window.end_s)
    after = (stamp_s >= window.end_s) & (stamp_s < end_s)
    lost, back = stamp_s[inside & ~good], stamp_s[after & good & ~gross]
    return FaultReaction(
        begin_s=float(window.begin_s - stamp_s[0]),
        reported_s=float(lost[0] - window.begin_s) if len(lost) else None,
        false_good_s=float(period_s[gross & (inside | after)].sum()),
        back_s=float(back[0] - window.end_s) if len(back) else None,
    )


def _gross(run: TrackingRun, truth: FloatArray, reference: BoolArray) -> BoolArray:
    """Return which frames (N,) are reported good with an error above GROSS_M.

    Estimate and truth are aligned on the good frames of reference (N,), which a windowed fault has not reached yet.
    """
    anchor, out = run.good & reference, np.zeros(len(truth), np.bool_)
    if anchor.sum() < MIN_POSES:
        return out
    world_from_odom = aligned(run.odom_from_body[anchor][:, :3, 3], truth[anchor][:, :3, 3])
    good = np.flatnonzero(run.good)
    moved = world_from_odom.apply(run.odom_from_body[good][:, :3, 3])
    out[good] = np.linalg.norm(moved - truth[good][:, :3, 3], axis=1) > GROSS_M
    return out
