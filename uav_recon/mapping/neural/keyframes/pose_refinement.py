"""Pose correction: views that see the same surface are moved until they agree, without leaving what localization said.

Gauss-Newton on the distances between small planes, for several views at once, the planes' own places eliminated (bundle
adjustment: Triggs et al. 2000; with planes: Liu and Zhang 2021), with the given poses as priors. How much given poses err is
learned from the corrections (expectation maximisation: Dempster et al. 1977). All views together must not drift: what they
have in common is a motion of the whole map, which nothing measures but the given poses, so it is taken out again.
"""

from __future__ import annotations

from itertools import compress

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.mapping.neural.keyframes.ray_buffer import RayBuffer
from uav_recon.mapping.neural.keyframes.surfels import NORMAL, POINT, VARIANCE, WEIGHT, Surfels
from uav_recon.types.frames import BoolArray, FloatArray, IntArray
from uav_recon.types.pose import Pose

GIVEN_SIGMA_M, GIVEN_SIGMA_RAD = 0.012, np.deg2rad(0.5)  # of given poses, before any view said more ...
BELIEF_VIEWS = 3.0  # ... and how many views that is worth
MIN_SIGMA_M, MIN_SIGMA_RAD = 0.002, np.deg2rad(0.06)
MAX_M, MAX_RAD = 0.10, np.deg2rad(5.0)  # a view that asks for more is left where it was
PATCH_SIGMA_M = 0.01  # of a patch's place across its plane: surfaces are not planes, and neighbours err alike
DEPTH_SHARE = 0.1  # of the depth's variance, after smoothing
SCALES_M = (0.08, 0.04, 0.02)  # distances that count half, one iteration after the other
FULL_RAYS = 4.0  # more do not make a patch better
ALIKE = 0.9  # least cosine between a patch's normal and its cell's
TOGETHER = 8  # views that move at once
FEWEST_SHARED = 20  # cells, to belong together
MIN_STEP_M, MIN_STEP_RAD = 0.0003, np.deg2rad(0.01)  # less is not worth gathering a view's patches anew
COMMON_M = 0.001  # a drift of the whole map that is taken out


class PoseRefinement:
    """Corrections (V, 6) of the given poses: translation in world and rotation vector about the camera."""

    def __init__(self, patches: Surfels) -> None:
        self._patches = patches
        self._rotation: list[FloatArray] = []
        self._position: list[FloatArray] = []
        self._square: FloatArray = np.zeros((0, 2))
        self._turn = 0
        self.correction: FloatArray = np.zeros((0, 6))

    def add(self, replay: RayBuffer) -> None:
        """Note the given pose world_from_depth of the next view of the replay."""
        view = len(self._rotation)
        self._rotation.append(replay.views.rotation[view].astype(np.float64))
        self._position.append(replay.views.position[view].astype(np.float64))
        self.correction = np.concatenate([self.correction, np.zeros((1, 6))])
        self._square = np.concatenate([self._square, np.zeros((1, 2))])
        self._move(view, replay)

    def keep(self, which: BoolArray) -> None:
        """Forget all views but some (V,), and whatever came after those."""
        self._rotation, self._position = list(compress(self._rotation, which)), list(compress(self._position, which))
        kept = np.flatnonzero(which)
        self._square, self.correction = self._square[kept], self.correction[kept]
        self._turn = 0

    @property
    def sigma(self) -> FloatArray:
        """Standard deviation of given poses, each axis (2,): metres and radians."""
        known = self._square[self._square[:, 0] > 0.0]
        believed = np.array([GIVEN_SIGMA_M, GIVEN_SIGMA_RAD])
        variance = (BELIEF_VIEWS * believed**2 + known.sum(axis=0) / 3.0) / (BELIEF_VIEWS + len(known))
        found: FloatArray = np.maximum(np.sqrt(variance), [MIN_SIGMA_M, MIN_SIGMA_RAD])
        return found

    def meet(self, replay: RayBuffer) -> None:
        """Align the newest view, then those about it, then those about an older one."""
        newest = len(self._rotation) - 1
        self._turn = self._turn + 1 if self._turn + 1 < newest else 0
        self._align_about(newest, 1, replay)
        self._align_about(newest, TOGETHER, replay)
        self._align_about(self._turn, TOGETHER, replay)
        self._settle(replay)

    def refine(self, replay: RayBuffer) -> None:
        """Align all views with each other. About 10 ms a view."""
        for centre in range(len(self._rotation)):
            self._align_about(centre, TOGETHER, replay)
        self._settle(replay)

    def _align_about(self, centre: int, together: int, replay: RayBuffer) -> None:
        beside, shared = self._patches.beside(centre)
        if len(beside) > 1:
            self._align(beside[:together][shared[:together] >= FEWEST_SHARED], beside, replay)

    def _align(self, views: IntArray, beside: IntArray, replay: RayBuffer) -> None:
        """Move views to agree with each other and with those beside."""
        if not len(views):
            return
        precision = np.tile(np.repeat(self.sigma, 3) ** -2, len(views))
        active = np.full(len(self._rotation), -1)
        active[views] = np.arange(len(views))
        for scale_m in SCALES_M:
            cell, whose, row = self._patches.of(views, beside)
            centre = replay.views.position[whose].astype(np.float64)
            normal, right = np.zeros((6 * len(views), 6 * len(views))), np.zeros(6 * len(views))
            gather_planes(cell, active[whose], row, centre, scale_m, normal, right)
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

    def _move(self, view: int, replay: RayBuffer) -> None:
        rotation, position = self._pose(view)
        v = replay.views
        v.rotation[view], v.position[view] = rotation, position
        records = v.records[v.first[view] : v.first[view + 1]]
        self._patches.place(view, records, rotation, position, float(v.inverse_depth_sigma[view]))

    def _settle(self, replay: RayBuffer) -> None:
        common = self._common()
        if np.abs(common[:, :3]).max() > COMMON_M:
            self.correction -= common
            for view in range(len(self._rotation)):
                self._move(view, replay)

    def _pose(self, view: int) -> tuple[FloatArray, FloatArray]:
        turn = Pose.from_rotation_vector(self.correction[view, 3:], np.zeros(3)).rotation()
        rotation: FloatArray = turn @ self._rotation[view]
        return rotation, self._position[view] + self.correction[view, :3]

    def _common(self) -> FloatArray:
        """The rigid motion of the whole map that explains the corrections best, as corrections (V, 6)."""
        precision = np.diag(1.0 / np.repeat(self.sigma, 3) ** 2)
        centre = np.stack(self._position)
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
def gather_planes(
    cell: IntArray, active: IntArray, row: FloatArray, centre: FloatArray, scale_m: float, normal: FloatArray, right: FloatArray
) -> None:
    """Add the normal equations of patches (N, COLUMNS) that are sorted by cell (N,). active (N,): which of the moving views a
    patch is of, or -1; centre (N, 3): where its camera is. Each cell's plane has its offset eliminated.
    """  # fmt: skip
    weight, distance, jacobian, plane = np.zeros(len(cell)), np.zeros(len(cell)), np.zeros((len(cell), 6)), np.zeros(3)
    first = 0
    while first < len(cell):
        end = first + 1
        while end < len(cell) and cell[end] == cell[first]:
            end += 1
        if end - first > 1 and _mean_normal(row[first:end], plane):
            offset, total = _compare(row[first:end], plane, scale_m, distance[first:end], weight[first:end])
            for n in range(first, end):
                _derive(row[n], centre[n], plane, jacobian[n])
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
def _mean_normal(row: FloatArray, plane: FloatArray) -> bool:
    plane[:] = 0.0
    for n in range(len(row)):
        for i in range(3):
            plane[i] += min(row[n, WEIGHT], FULL_RAYS) * row[n, NORMAL.start + i]
    length = np.sqrt(plane[0] ** 2 + plane[1] ** 2 + plane[2] ** 2)
    plane /= max(length, 1e-9)
    return bool(length > 1e-6)


@kernel
def _compare(
    row: FloatArray, plane: FloatArray, scale_m: float, distance: FloatArray, weight: FloatArray
) -> tuple[float, float]:
    """Distances (N,) of a cell's patches along its normal and their weights (N,); returns the mean and the sum of weights.

    Cauchy's weights about the mean, from the median on: a surface that one view alone saw in a cell counts little.
    """
    for n in range(len(row)):
        distance[n], facing = 0.0, 0.0
        for i in range(3):
            distance[n] += plane[i] * row[n, POINT.start + i]
            facing += plane[i] * row[n, NORMAL.start + i]
        variance = PATCH_SIGMA_M**2 + DEPTH_SHARE * row[n, VARIANCE]
        weight[n] = min(row[n, WEIGHT] / FULL_RAYS, 1.0) / variance if facing > ALIKE else 0.0
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
def _derive(row: FloatArray, centre: FloatArray, plane: FloatArray, jacobian: FloatArray) -> None:
    """Of a patch's distance, by its view's translation and rotation about the camera (6,)."""
    x, y, z = row[POINT.start] - centre[0], row[POINT.start + 1] - centre[1], row[POINT.start + 2] - centre[2]
    a, b, c = plane
    jacobian[0], jacobian[1], jacobian[2] = a, b, c
    jacobian[3], jacobian[4], jacobian[5] = y * c - z * b, z * a - x * c, x * b - y * a
