"""Pose refinement: adjusts keyframe poses so that views of the same surface agree.

Gauss-Newton on the distances between small planes, for several views at once, with the positions of the planes eliminated
(bundle adjustment: Triggs et al. 2000; with planes: Liu and Zhang 2021) and with the given poses as priors. The error of the
given poses is estimated from the corrections (expectation maximisation: Dempster et al. 1977). The whole map must not drift:
a motion common to all views is only constrained by the given poses, so it is removed again.
"""

from __future__ import annotations

from itertools import compress

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.mapping.neural.keyframes.captured_view import CapturedView
from uav_recon.mapping.neural.keyframes.ray_buffer import RayBuffer
from uav_recon.mapping.neural.keyframes.surfels import NORMAL, POINT, VARIANCE, WEIGHT, Surfels
from uav_recon.types.camera_calibration import CameraCalibration
from uav_recon.types.frames import BoolArray, FloatArray, IntArray
from uav_recon.types.pose import Pose

# prior sigma of given poses ...
GIVEN_SIGMA_M = 0.012
GIVEN_SIGMA_RAD = np.deg2rad(0.5)
PRIOR_WEIGHT_VIEWS = 3.0  # ... and the weight of this prior in views
MIN_SIGMA_M = 0.002
MIN_SIGMA_RAD = np.deg2rad(0.06)
# a view that needs a larger correction is not moved
MAX_M = 0.10
MAX_RAD = np.deg2rad(5.0)
PATCH_SIGMA_M = 0.01  # sigma of a surfel across its plane: surfaces are not planar, and errors of neighbours are correlated
SCALES_M = (0.08, 0.04, 0.02)  # distances with half weight, one per iteration
FULL_RAYS = 20.0  # a surfel does not improve with more rays; one at the border of its cell, with few, is drawn to its middle
MIN_NORMAL_COSINE = 0.98
LEAST_SQUARE = 0.9
MAX_SHARE = 0.2  # a point that is farther from its plane, as a share of its range, does not see that plane
JOINT_VIEWS = 8  # views refined together
FEWEST_SHARED = 20  # minimum number of shared cells for views refined together
# smaller steps do not justify recomputing a view's surfels
MIN_STEP_M = 0.0003
MIN_STEP_RAD = np.deg2rad(0.01)
COMMON_M = 0.001  # drift of the whole map above which it is removed


class PoseRefinement:
    """Corrections (V, 6) of the given poses.

    Translation in world and rotation vector about the camera. calibration: errors of the camera, the same for all views.
    """

    def __init__(self, patches: Surfels) -> None:
        self._patches = patches
        self.captured: list[CapturedView] = []
        self.calibration = CameraCalibration.none()
        self._square: FloatArray = np.zeros((0, 2))
        self._turn = 0
        self.correction: FloatArray = np.zeros((0, 6))

    def add(self, replay: RayBuffer, captured: CapturedView) -> None:
        """Add the next view of the buffer."""
        view = len(self.captured)
        self.captured.append(captured)
        self.correction = np.concatenate([self.correction, np.zeros((1, 6))])
        self._square = np.concatenate([self._square, np.zeros((1, 2))])
        self._move(view, replay)

    def keep(self, which: BoolArray) -> None:
        """Drop all views except those selected by a mask (V,).

        Views beyond the end of the mask are dropped too.
        """
        self.captured = list(compress(self.captured, which))
        kept = np.flatnonzero(which)
        self._square = self._square[kept]
        self.correction = self.correction[kept]
        self._turn = 0

    @property
    def sigma(self) -> FloatArray:
        """Standard deviation (2,) of the given poses per axis, in metres and radians."""
        known = self._square[self._square[:, 0] > 0.0]
        prior_sigma = np.array([GIVEN_SIGMA_M, GIVEN_SIGMA_RAD])
        variance = (PRIOR_WEIGHT_VIEWS * prior_sigma**2 + known.sum(axis=0) / 3.0) / (PRIOR_WEIGHT_VIEWS + len(known))
        found: FloatArray = np.maximum(np.sqrt(variance), [MIN_SIGMA_M, MIN_SIGMA_RAD])
        return found

    def learn_sigma(self, variance: FloatArray) -> None:
        """Learn the error of given poses from all corrections, whose variances (V, 6) are known."""
        self._square = (self.correction**2 + variance).reshape(-1, 2, 3).sum(axis=2)

    def meet(self, replay: RayBuffer) -> None:
        """Refine the newest view, then the views near it, then the views near an older one."""
        newest = len(self.captured) - 1
        self._turn = self._turn + 1 if self._turn + 1 < newest else 0
        self._align_about(newest, 1, replay)
        self._align_about(newest, JOINT_VIEWS, replay)
        self._align_about(self._turn, JOINT_VIEWS, replay)
        self._settle(replay)

    def _align_about(self, centre: int, together: int, replay: RayBuffer) -> None:
        beside, shared = self._patches.overlapping_views(centre)
        if len(beside) > 1:
            self._align(beside[:together][shared[:together] >= FEWEST_SHARED], beside, replay)

    def _align(self, views: IntArray, beside: IntArray, replay: RayBuffer) -> None:
        """Refine ``views`` to agree with each other and with the views ``beside``."""
        if not len(views):
            return
        precision = np.tile(np.repeat(self.sigma, 3) ** -2, len(views))
        active = np.full(len(self.captured), -1)
        active[views] = np.arange(len(views))
        for scale_m in SCALES_M:
            cell, whose, row = self._patches.of(views, beside)
            centre = replay.views.position[whose].astype(np.float64)
            normal, right = np.zeros((6 * len(views), 6 * len(views))), np.zeros(6 * len(views))
            accumulate_normal_equations(cell, active[whose], row, centre, scale_m, normal, right)
            normal[np.diag_indices(len(normal))] += precision
            step = np.linalg.solve(normal, right + precision * self.correction[views].ravel()).reshape(-1, 6)
            wanted = self.correction[views] - step
            near = (np.linalg.norm(wanted[:, :3], axis=1) < MAX_M) & (np.linalg.norm(wanted[:, 3:], axis=1) < MAX_RAD)
            near &= (np.abs(step) > np.repeat([MIN_STEP_M, MIN_STEP_RAD], 3)).any(axis=1)
            self.correction[views[near]] = wanted[near]
            for view in views[near]:
                self._move(int(view), replay)
        square = self.correction[views] ** 2 + np.diag(np.linalg.inv(normal)).reshape(-1, 6)
        self._square[views] = square.reshape(-1, 2, 3).sum(axis=2)

    def move_all(self, replay: RayBuffer) -> None:
        """Give all views the poses and lenses of the present calibration and corrections."""
        for view in range(len(self.captured)):
            self._move(view, replay)

    def _move(self, view: int, replay: RayBuffer) -> None:
        rotation, position = self._pose(view)
        v = replay.views
        v.rotation[view], v.position[view], v.stretch[view] = rotation, position, self.calibration.stretch
        records = v.records[v.first[view] : v.first[view + 1]]
        lens = np.array([v.inverse_depth_sigma[view], *v.stretch[view]])
        self._patches.place(view, records, self.captured[view].measured, rotation, position, lens)

    def _settle(self, replay: RayBuffer) -> None:
        common = self._common()
        if np.abs(common[:, :3]).max() > COMMON_M:
            self.correction -= common
            self.move_all(replay)

    def _pose(self, view: int) -> tuple[FloatArray, FloatArray]:
        seen = self.calibration.pose(self.captured[view].given)
        turn = Pose.from_rotation_vector(self.correction[view, 3:], np.zeros(3)).rotation()
        rotation: FloatArray = turn @ seen.rotation()
        return rotation, seen.translation_m + self.correction[view, :3]

    def _common(self) -> FloatArray:
        """Return the rigid motion of the whole map that best explains the corrections.

        The motion has the form of corrections (V, 6).
        """
        precision = np.diag(1.0 / np.repeat(self.sigma, 3) ** 2)
        centre = np.stack([each.given.odom_from_depth.translation_m for each in self.captured])
        rows = np.zeros((len(centre), 6, 6))
        rows[:, :3, :3] = np.eye(3)
        rows[:, 3:, 3:] = np.eye(3)
        for column, axis in enumerate(np.eye(3)):
            rows[:, :3, 3 + column] = np.cross(axis, centre)
        normal = np.einsum("vij,ik,vkl->jl", rows, precision, rows)
        motion = np.linalg.solve(normal, np.einsum("vij,ik,vk->j", rows, precision, self.correction))
        common: FloatArray = rows @ motion
        return common


@kernel
def accumulate_normal_equations(  # noqa: C901
    cell: IntArray, active: IntArray, row: FloatArray, centre: FloatArray, scale_m: float, normal: FloatArray, right: FloatArray
) -> None:
    """Add the normal equations of surfels (N, COLUMNS), sorted by cell (N,).

    active (N,): index of the moving view of a surfel, or -1; centre (N, 3): position of its camera. The offset of each
    cell's plane is eliminated.
    """
    count = len(cell)
    weight, distance, jacobian = np.zeros(count), np.zeros(count), np.zeros((count, 6))
    plane, point = np.zeros(3), np.zeros(3)
    first = 0
    while first < len(cell):
        end = first + 1
        while end < len(cell) and cell[end] == cell[first]:
            end += 1
        if end - first > 1 and mean_normal(row[first:end], plane):
            offset, total = compare(row[first:end], plane, scale_m, distance[first:end], weight[first:end])
            for n in range(first, end):
                on_plane(row[n, POINT.start : POINT.stop], centre[n], plane, distance[n] - offset, point)
                derive(point, centre[n], plane, jacobian[n])
            for n in range(first, end):
                if active[n] < 0 or weight[n] == 0.0:
                    continue
                a = 6 * active[n]
                for i in range(6):
                    right[a + i] += weight[n] * (distance[n] - offset) * jacobian[n, i]
                    for j in range(6):
                        normal[a + i, a + j] += weight[n] * jacobian[n, i] * jacobian[n, j]
                for m in range(first, end):
                    if active[m] < 0:
                        continue
                    b, share = 6 * active[m], weight[n] * weight[m] / total
                    for i in range(6):
                        for j in range(6):
                            normal[a + i, b + j] -= share * jacobian[n, i] * jacobian[m, j]
        first = end


@kernel
def mean_normal(row: FloatArray, plane: FloatArray) -> bool:
    """Compute the unit mean normal (3,) of a cell's surfels; returns False if there is none."""
    plane[:] = 0.0
    for n in range(len(row)):
        for i in range(3):
            plane[i] += min(row[n, WEIGHT], FULL_RAYS) * row[n, NORMAL.start + i]
    length = np.sqrt(plane[0] ** 2 + plane[1] ** 2 + plane[2] ** 2)
    plane /= max(length, 1e-9)
    return bool(length > 1e-6)


@kernel
def compare(
    row: FloatArray, plane: FloatArray, scale_m: float, distance: FloatArray, weight: FloatArray
) -> tuple[float, float]:
    """Compute distances (N,) of a cell's surfels along its normal, and weights (N,).

    Returns the mean distance and the sum of weights. Cauchy weights about the mean, starting from the median: surface that
    only one view sees in a cell gets a low weight.
    """
    for n in range(len(row)):
        distance[n], facing, length = 0.0, 0.0, 0.0
        for i in range(3):
            distance[n] += plane[i] * row[n, POINT.start + i]
            facing += plane[i] * row[n, NORMAL.start + i]
            length += row[n, NORMAL.start + i] ** 2
        facing = facing / np.sqrt(length) if length > LEAST_SQUARE else 0.0
        variance = PATCH_SIGMA_M**2 + row[n, VARIANCE] / max(row[n, WEIGHT], 1.0)
        weight[n] = min(row[n, WEIGHT] / FULL_RAYS, 1.0) / variance if facing > MIN_NORMAL_COSINE else 0.0
    offset, total = float(np.median(distance)), 0.0
    for turn in range(2):
        centre, offset, total = offset, 0.0, 1e-9
        for n in range(len(row)):
            robust = weight[n] / (1.0 + ((distance[n] - centre) / scale_m) ** 2)
            total += robust
            offset += robust * distance[n]
            if turn == 1:
                weight[n] = robust
        offset /= total
    return offset, total


@kernel
def on_plane(measured: FloatArray, centre: FloatArray, plane: FloatArray, off_m: float, point: FloatArray) -> None:
    """Compute where the ray to a measured point (3,) meets its plane.

    The point is off by off_m along the normal of the plane (3,).

    Derivatives are taken there: at the measured point they would follow its noise, and a smaller map, or one seen at a smaller
    angle, would always fit better (errors in variables: Fuller 1987). centre (3,): position of the camera.
    """
    along = 0.0
    for i in range(3):
        along += plane[i] * (measured[i] - centre[i])
    share = 1.0 - min(max(off_m / along, -MAX_SHARE), MAX_SHARE) if along != 0.0 else 1.0
    for i in range(3):
        point[i] = centre[i] + share * (measured[i] - centre[i])


@kernel
def derive(point: FloatArray, centre: FloatArray, plane: FloatArray, jacobian: FloatArray) -> None:
    """Compute the derivative (6,) of a point's distance with respect to the pose of its view.

    The pose is its translation and rotation about the camera.
    """
    x, y, z = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    a, b, c = plane
    jacobian[0], jacobian[1], jacobian[2] = a, b, c
    jacobian[3], jacobian[4], jacobian[5] = y * c - z * b, z * a - x * c, x * b - y * a
