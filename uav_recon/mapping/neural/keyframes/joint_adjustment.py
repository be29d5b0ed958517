"""Joint adjustment: errors of the camera and poses of all views, from shared surfaces.

Gauss-Newton on the distances between surfels of one cell, with the position of the cell's plane eliminated (bundle adjustment
with planes: Liu and Zhang 2021), over the poses of all views and the dozen numbers that are the same in every view. Poses are
given with an error that drifts: its covariance between two views falls with the time between them. The covariance of the result
is that of the scores of patches of surface (sandwich estimator: Huber 1967, White 1980): neighbouring surfels err together.
"""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.camera_error_row import error_row
from uav_recon.geometry.jit import kernel
from uav_recon.mapping.neural.keyframes.estimated_errors import EstimatedErrors
from uav_recon.mapping.neural.keyframes.pose_refinement import (
    PoseRefinement,
    compare,
    derive,
    mean_normal,
    on_plane,
)
from uav_recon.mapping.neural.keyframes.ray_buffer import RayBuffer
from uav_recon.mapping.neural.keyframes.surfels import NORMAL, POINT, Surfels
from uav_recon.types.camera_calibration import ERROR_SIGMAS, HIDDEN_BY_OWN_POSES, CameraCalibration
from uav_recon.types.frames import BoolArray, FloatArray, IntArray
from uav_recon.types.pose import Pose

NAMES = tuple(ERROR_SIGMAS)
ELEMENTS = len(NAMES)
SCALE = NAMES.index("depth_scale")
PRIOR_SIGMA: FloatArray = np.array(list(ERROR_SIGMAS.values()))
# shares of the prior deviation that are added: surface is not planar, and the shadow beside a near object is on one side of it
SYSTEMATIC_SHARE: FloatArray = np.array([0.08] * 6 + [0.3] * 3)
# distances with half weight, one per iteration: of the first adjustment, and of later ones
FIRST_SCALES_M = (0.08, 0.04, 0.02, 0.02, 0.02)
SCALES_M = (0.02, 0.02)
DRIFT_TIME_S = 15.0  # correlation time of the errors of given poses
# share of their variance that is not correlated: before the corrections show it, and at least
WHITE_SHARE = 0.2
LEAST_WHITE_SHARE = 0.05
NEIGHBOURS_S = 5.0  # views that are closer in time show that share
FEWEST_NEIGHBOURS = 8
HELD_OUT = 5  # every fifth view judges what the others estimate
PATCH_M = 0.8  # edge of a patch of surface whose surfels err together


def calibration_of(value: FloatArray) -> CameraCalibration:
    """Return the correction that removes errors (9,)."""
    wrong = Pose.from_rotation_vector(value[1:4], value[6:9])
    return CameraCalibration(float(value[0]), wrong.inverse(), float(value[4]), float(value[5]))


class JointAdjustment:
    """Adjusts the views of a PoseRefinement and its calibration.

    own_poses: the poses come from the depth images. They then have the camera's wrong delay, mount and scale too, and no view
        shows these. Of them, only the scale changes the model: its size.
    """

    def __init__(self, patches: Surfels, *, own_poses: bool = False) -> None:
        self._patches = patches
        self._own_poses = own_poses
        self._scales_m: tuple[float, ...] = FIRST_SCALES_M
        self._white_share = WHITE_SHARE
        self._applied = True
        self.value: FloatArray = np.zeros(ELEMENTS)

    def adjust(self, alignment: PoseRefinement, replay: RayBuffer) -> EstimatedErrors:
        """Adjust poses and errors of the camera; returns the errors. Takes 0.3 s for 60 views."""
        stamps_s = np.array([each.stamp_s for each in alignment.captured])
        prior = self._prior(stamps_s, alignment.sigma)
        free = np.full(ELEMENTS, self._applied)
        normal, scores = self._solve(alignment, replay, np.arange(len(stamps_s)), prior, free)
        self._scales_m = SCALES_M
        self._white_share = self._shown_white_share(stamps_s, alignment.correction / np.repeat(alignment.sigma, 3))
        posterior = np.linalg.inv(normal)
        alignment.learn_sigma(np.diagonal(posterior)[ELEMENTS:].reshape(-1, 6))
        influence = np.asarray(posterior[:ELEMENTS], dtype=np.float64)
        covariance = self._covariance(influence, scores, prior) if self._applied else np.diag(PRIOR_SIGMA**2)
        hidden = HIDDEN_BY_OWN_POSES if self._own_poses else frozenset[str]()
        return EstimatedErrors(NAMES, self.value.copy(), covariance, hidden)

    def judge(self, alignment: PoseRefinement, replay: RayBuffer) -> None:
        """Stop correcting errors of the camera if views that are held out fit worse with it.

        Every HELD_OUT-th view is held out. Poses are adjusted in both cases, from the same ones. Distances are compared at the
        scale at which they were measured: in a smaller map they would all be less. Takes twice as long as adjust().
        """
        views = len(alignment.captured)
        every = np.arange(views)
        held = every % HELD_OUT == HELD_OUT - 1
        if not held.any():
            return
        before = self.value, alignment.correction.copy()
        stamps_s = np.array([each.stamp_s for each in alignment.captured])
        prior, fixed = self._prior(stamps_s, alignment.sigma), np.zeros(ELEMENTS, dtype=np.bool_)
        self._solve(alignment, replay, np.flatnonzero(~held), prior, ~fixed)
        cost = []
        for value in (self.value, np.zeros(ELEMENTS)):
            self.value, alignment.correction[:] = value, before[1]
            self._solve(alignment, replay, every, prior, fixed)
            cell, whose, row = self._patches.of(every, every)
            cost.append(_held_out_cost(cell, held[whose], row, SCALES_M[-1] / (1.0 + value[SCALE])))
        self._applied = cost[0] <= cost[1]
        self.value, alignment.correction[:] = before
        if not self._applied:
            self.value = np.zeros(ELEMENTS)
        alignment.calibration = calibration_of(self.value)
        alignment.move_all(replay)

    def _solve(
        self, alignment: PoseRefinement, replay: RayBuffer, used: IntArray, prior: FloatArray, free: BoolArray
    ) -> tuple[FloatArray, FloatArray]:
        """Adjust all poses and the free errors of the camera to the views used.

        Returns the matrix of the last normal equations, and the scores (G, S) of patches of surface.
        """
        fixed = np.flatnonzero(~free)
        alignment.calibration = calibration_of(self.value)
        alignment.move_all(replay)
        for scale_m in self._scales_m:
            cell, whose, row = self._patches.of(used, used)
            groups, patch = self._groups(cell, row)
            normal, right, scores = np.zeros(prior.shape), np.zeros(len(prior)), np.zeros((groups, len(prior)))
            _accumulate(cell, whose, row, patch, self._motion(alignment, replay), scale_m, normal, right, scores)
            state: FloatArray = np.concatenate([self.value, alignment.correction.ravel()])
            normal, right = normal + prior, right + prior @ state
            normal[fixed], normal[:, fixed], right[fixed] = 0.0, 0.0, 0.0
            normal[fixed, fixed] = 1.0
            state -= np.linalg.solve(normal, right)
            self.value, alignment.correction[:] = state[:ELEMENTS], state[ELEMENTS:].reshape(-1, 6)
            alignment.calibration = calibration_of(self.value)
            alignment.move_all(replay)
        return normal, scores

    def _covariance(self, influence: FloatArray, scores: FloatArray, prior: FloatArray) -> FloatArray:
        """Return the covariance of the errors.

        influence (9, S): effect of right-hand sides on them; scores (G, S): of the patches of surface.
        """
        effect = scores @ influence.T
        covariance: FloatArray = effect.T @ effect + influence @ prior @ influence.T
        covariance = covariance + np.diag((SYSTEMATIC_SHARE * PRIOR_SIGMA) ** 2)
        at_prior = PRIOR_SIGMA / np.sqrt(np.diagonal(covariance))
        share = np.minimum(at_prior, 1.0)
        if self._own_poses:
            share[SCALE] = at_prior[SCALE]
        covariance *= np.outer(share, share)
        return covariance

    def _shown_white_share(self, stamps_s: FloatArray, correction: FloatArray) -> float:
        """Return the share of the variance of corrections (V, 6) that neighbours do not share."""
        apart_s = np.diff(stamps_s)
        near = (apart_s > 0.0) & (apart_s < NEIGHBOURS_S)
        if near.sum() < FEWEST_NEIGHBOURS:
            return self._white_share
        common = np.exp(-apart_s[near] / DRIFT_TIME_S).mean()
        differ = np.square(np.diff(correction, axis=0)[near]).mean() / max(2.0 * float(correction.var(axis=0).mean()), 1e-12)
        return float(np.clip(1.0 - (1.0 - differ) / common, LEAST_WHITE_SHARE, 1.0))

    def _prior(self, stamps_s: FloatArray, sigma: FloatArray) -> FloatArray:
        """Return the inverse of the covariance of errors of the camera and of given poses."""
        views = len(stamps_s)
        apart_s = np.abs(stamps_s[:, None] - stamps_s[None])
        shape = (1.0 - self._white_share) * np.exp(-apart_s / DRIFT_TIME_S) + self._white_share * np.eye(views)
        alike = np.linalg.inv(shape)
        prior = np.zeros((ELEMENTS + 6 * views,) * 2)
        prior[np.arange(ELEMENTS), np.arange(ELEMENTS)] = PRIOR_SIGMA**-2
        for axis in range(6):
            at = ELEMENTS + axis + 6 * np.arange(views)
            prior[np.ix_(at, at)] = alike / sigma[axis // 3] ** 2
        return prior

    @staticmethod
    def _groups(cell: IntArray, row: FloatArray) -> tuple[int, IntArray]:
        """Return the number of patches of surface, and the patch (N,) of each surfel.

        cell (N,): ascending. All surfels of a cell are in one patch: which one must not depend on their errors.
        """
        first = np.flatnonzero(np.diff(cell, prepend=-1))
        count = np.diff(first, append=len(cell))
        mean = np.add.reduceat(row[:, POINT.start : NORMAL.stop], first) / count[:, None]
        axis = np.abs(mean[:, 3:]).argmax(axis=1)[:, None]
        side = 2 * axis + (np.take_along_axis(mean[:, 3:], axis, 1) > 0.0)
        place = np.floor(mean[:, :3] / PATCH_M).astype(np.int64)
        np.put_along_axis(place, axis, np.rint(np.take_along_axis(mean[:, :3], axis, 1) / PATCH_M).astype(np.int64), 1)
        _, patch = np.unique(np.column_stack([place, side]), axis=0, return_inverse=True)
        return int(patch.max(initial=-1)) + 1, np.repeat(patch.ravel().astype(np.int64), count)

    @staticmethod
    def _motion(alignment: PoseRefinement, replay: RayBuffer) -> FloatArray:
        """Return rotation, position, velocity and turn rate of the views (V, 18)."""
        views = replay.views
        out = np.empty((len(alignment.captured), 18))
        for n, each in enumerate(alignment.captured):
            out[n, :9] = views.rotation[n].ravel()
            out[n, 9:12] = views.position[n]
            out[n, 12:15], out[n, 15:] = each.given.velocity_mps, each.given.rate_radps
        return out


@kernel
def _accumulate(  # noqa: C901, PLR0912 - one pass over the cells
    cell: IntArray, whose: IntArray, row: FloatArray, patch: IntArray, motion: FloatArray, scale_m: float,
    normal: FloatArray, right: FloatArray, scores: FloatArray,
) -> None:  # fmt: skip
    """Add the normal equations of all surfels, sorted by cell.

    scores (G, S): right-hand side of each patch of surface.
    """
    count = len(cell)
    weight, distance, jacobian, common = np.zeros(count), np.zeros(count), np.zeros((count, 6)), np.zeros((count, 9))
    plane, mean, point = np.zeros(3), np.zeros(9), np.zeros(3)
    first = 0
    while first < count:
        end = first + 1
        while end < count and cell[end] == cell[first]:
            end += 1
        if end - first > 1 and mean_normal(row[first:end], plane):
            offset, total = compare(row[first:end], plane, scale_m, distance[first:end], weight[first:end])
            mean[:] = 0.0
            for n in range(first, end):
                m = motion[whose[n]]
                on_plane(row[n, 1:4], m[9:12], plane, distance[n] - offset, point)
                derive(point, m[9:12], plane, jacobian[n])
                common[n] = -error_row(plane, point, m[:9].reshape(3, 3), m[9:12], m[12:15], m[15:18])
                for i in range(9):
                    mean[i] += weight[n] / total * common[n, i]
            for n in range(first, end):
                if weight[n] == 0.0:
                    continue
                a, left, score = 9 + 6 * whose[n], weight[n] * (distance[n] - offset), scores[patch[n]]
                for i in range(9):
                    c = weight[n] * (common[n, i] - mean[i])
                    right[i] += left * (common[n, i] - mean[i])
                    score[i] += left * (common[n, i] - mean[i])
                    for j in range(9):
                        normal[i, j] += c * (common[n, j] - mean[j])
                    for j in range(6):
                        normal[i, a + j] += c * jacobian[n, j]
                        normal[a + j, i] += c * jacobian[n, j]
                for i in range(6):
                    right[a + i] += left * jacobian[n, i]
                    score[a + i] += left * jacobian[n, i]
                    for j in range(6):
                        normal[a + i, a + j] += weight[n] * jacobian[n, i] * jacobian[n, j]
                for k in range(first, end):
                    b, share = 9 + 6 * whose[k], weight[n] * weight[k] / total
                    for i in range(6):
                        for j in range(6):
                            normal[a + i, b + j] -= share * jacobian[n, i] * jacobian[k, j]
        first = end


@kernel
def _held_out_cost(cell: IntArray, held: BoolArray, row: FloatArray, scale_m: float) -> float:
    """Return the mean robust cost of surfels, sorted by cell, of the views held out."""
    count = len(cell)
    weight, distance, plane = np.zeros(count), np.zeros(count), np.zeros(3)
    cost, total, first = 0.0, 1e-9, 0
    while first < count:
        end = first + 1
        while end < count and cell[end] == cell[first]:
            end += 1
        if end - first > 1 and mean_normal(row[first:end], plane):
            offset, _ = compare(row[first:end], plane, scale_m, distance[first:end], weight[first:end])
            for n in range(first, end):
                if held[n]:
                    square = ((distance[n] - offset) / scale_m) ** 2
                    full = weight[n] * (1.0 + square)
                    cost += full * np.log1p(square)
                    total += full
        first = end
    return cost / total
