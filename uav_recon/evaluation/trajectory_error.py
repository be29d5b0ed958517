"""Errors of an estimated trajectory against the true one.

Definitions of Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems", IROS 2012: absolute trajectory error after
rigid alignment without scale, and relative pose error over a length of path.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import FloatArray, IntArray
from uav_recon.types.pose import Pose

DRIFT_LENGTH_M = 2.0
MIN_POSES = 3  # an alignment needs three positions


@dataclass(frozen=True, slots=True)
class TrajectoryError:
    """Errors of N poses.

    ate_m: root mean square of the position error after alignment; ate_max_m: the largest.
    rotation_rad: root mean square angle between estimated and true attitude after the same alignment.
    drift: mean translation error of the relative pose over DRIFT_LENGTH_M of path, divided by the path between; drift_median,
    drift_p95: of the same errors.
    drift_radpm: mean rotation error of the same relative poses, rad/m. NaN if the path is shorter.
    length_m: of the true path.
    """

    ate_m: float
    ate_max_m: float
    rotation_rad: float
    drift: float
    drift_median: float
    drift_p95: float
    drift_radpm: float
    length_m: float


def aligned(estimate_m: FloatArray, truth_m: FloatArray) -> Pose:
    """Return truth_from_estimate, the rigid transform that fits positions (N, 3) best.

    Least squares, without scale. Raises ValueError for fewer than MIN_POSES positions or different shapes. Umeyama, "Least-
    squares estimation of transformation parameters between two point patterns", PAMI 1991, equations 38 to 43 with c = 1.
    """
    estimate_m, truth_m = np.asarray(estimate_m, np.float64), np.asarray(truth_m, np.float64)
    if estimate_m.shape != truth_m.shape or estimate_m.ndim != 2 or len(estimate_m) < MIN_POSES:
        raise ValueError(f"want two arrays (N, 3) with N of at least {MIN_POSES}, got {estimate_m.shape} and {truth_m.shape}")
    estimate_mean, truth_mean = estimate_m.mean(axis=0), truth_m.mean(axis=0)
    u, _, vt = np.linalg.svd((truth_m - truth_mean).T @ (estimate_m - estimate_mean))
    sign = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u) * np.linalg.det(vt)))])
    matrix = np.eye(4)
    matrix[:3, :3] = u @ sign @ vt
    matrix[:3, 3] = truth_mean - matrix[:3, :3] @ estimate_mean
    return Pose.from_matrix(matrix)


def scale_of(estimate_m: FloatArray, truth_m: FloatArray) -> float:
    """Return the factor by which positions (N, 3) must grow to fit the true ones best.

    Umeyama 1991, equation 42.
    """
    rotation = aligned(estimate_m, truth_m).rotation()
    estimate_m, truth_m = estimate_m - estimate_m.mean(axis=0), truth_m - truth_m.mean(axis=0)
    return float((truth_m * (estimate_m @ rotation.T)).sum() / max(float((estimate_m**2).sum()), 1e-12))


def timed_errors_m(odom_from_body: FloatArray, world_from_body: FloatArray, stamp_s: FloatArray, span_s: float) -> FloatArray:
    """Return the errors (K,) of the relative translation over a time.

    A pair is each pose and the nearest one that much later. stamp_s (N,): of the poses, ascending. Pairs that differ from the
    time by more than half a usual step are left out.
    """
    ends: IntArray = np.searchsorted(stamp_s, stamp_s + span_s)
    before = np.clip(ends - 1, 0, len(stamp_s) - 1)
    ends = np.clip(ends, 0, len(stamp_s) - 1)
    ends = np.where(np.abs(stamp_s[before] - stamp_s - span_s) < np.abs(stamp_s[ends] - stamp_s - span_s), before, ends)
    starts = np.flatnonzero(np.abs(stamp_s[ends] - stamp_s - span_s) <= 0.51 * float(np.median(np.diff(stamp_s))))
    ends = ends[starts]
    moved = _inverse(odom_from_body[starts]) @ odom_from_body[ends]
    truly = _inverse(world_from_body[starts]) @ world_from_body[ends]
    return np.asarray(np.linalg.norm((_inverse(truly) @ moved)[:, :3, 3], axis=1))


def position_errors_m(odom_from_body: FloatArray, world_from_body: FloatArray) -> FloatArray:
    """Return the position error (N,), m, of each of N poses (N, 4, 4) after alignment."""
    world_from_odom = aligned(odom_from_body[:, :3, 3], world_from_body[:, :3, 3])
    moved = world_from_odom.apply(odom_from_body[:, :3, 3])
    return np.asarray(np.linalg.norm(moved - world_from_body[:, :3, 3], axis=1))


def trajectory_error(odom_from_body: FloatArray, world_from_body: FloatArray) -> TrajectoryError:
    """Return the errors of estimated poses (N, 4, 4) against true ones at the same instants.

    Raises ValueError as aligned().
    """
    world_from_odom = aligned(odom_from_body[:, :3, 3], world_from_body[:, :3, 3])
    error_m = position_errors_m(odom_from_body, world_from_body)
    moved = world_from_odom.rotation() @ odom_from_body[:, :3, :3]
    angle = rotation_angles_rad(np.swapaxes(world_from_body[:, :3, :3], 1, 2) @ moved)
    path_m = path_lengths_m(world_from_body[:, :3, 3])
    drift, turn = relative_errors(odom_from_body, world_from_body, path_m, DRIFT_LENGTH_M)
    known = len(drift) > 0
    return TrajectoryError(
        ate_m=_rms(error_m),
        ate_max_m=float(error_m.max()),
        rotation_rad=_rms(angle),
        drift=float(drift.mean()) if known else np.nan,
        drift_median=float(np.median(drift)) if known else np.nan,
        drift_p95=float(np.percentile(drift, 95)) if known else np.nan,
        drift_radpm=float(turn.mean()) if known else np.nan,
        length_m=float(path_m[-1]),
    )


def path_lengths_m(position_m: FloatArray) -> FloatArray:
    """Return the length of path (N,), m, up to each position (N, 3)."""
    steps = np.linalg.norm(np.diff(position_m, axis=0), axis=1)
    return np.concatenate(([0.0], np.cumsum(steps)))


def relative_errors(
    odom_from_body: FloatArray, world_from_body: FloatArray, path_m: FloatArray, length_m: float
) -> tuple[FloatArray, FloatArray]:
    """Return the relative pose errors (K,) over length_m of path: m/m and rad/m.

    A pair is each pose and the first one at least length_m of path later; poses without such a partner are left out.
    """
    ends: IntArray = np.searchsorted(path_m, path_m + length_m, side="left")
    starts = np.flatnonzero(ends < len(path_m))
    ends = ends[starts]
    moved = _inverse(odom_from_body[starts]) @ odom_from_body[ends]
    truly = _inverse(world_from_body[starts]) @ world_from_body[ends]
    wrong = _inverse(truly) @ moved
    between_m = path_m[ends] - path_m[starts]
    return np.linalg.norm(wrong[:, :3, 3], axis=1) / between_m, rotation_angles_rad(wrong[:, :3, :3]) / between_m


def rotation_angles_rad(rotation: FloatArray) -> FloatArray:
    """Return the angle (N,), rad in [0, pi], of rotations (N, 3, 3), accurate at both ends."""
    r = rotation
    axis = np.stack([r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]], axis=1)
    return np.asarray(np.arctan2(np.linalg.norm(axis, axis=1), np.trace(r, axis1=1, axis2=2) - 1.0))


def _inverse(poses: FloatArray) -> FloatArray:
    turned = np.swapaxes(poses[:, :3, :3], 1, 2)
    out = np.tile(np.eye(4), (len(poses), 1, 1))
    out[:, :3, :3] = turned
    out[:, :3, 3] = -(turned @ poses[:, :3, 3, None])[..., 0]
    return out


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
