"""Localizability map: surface as a camera uses it to tell where it is.

Cells of 0.2 m. Each holds the first two moments of its surface points, whose smallest axis is the normal, and how many corners
an image of it shows.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from uav_recon.geometry import view_information
from uav_recon.geometry.view_information import GOOD_M, Eye, view_sigmas
from uav_recon.types.camera import Frame, PosedFrame
from uav_recon.types.frames import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from uav_recon.types.localizability import SurfaceCells
from uav_recon.types.maps import GridSpec
from uav_recon.types.pose import Pose

CELL_M = 0.2
_SPACING_S = 0.3  # between frames that are taken
_PATCH_SHARE = 1.0 / 53.0  # of the width of the depth image
_NEAREST_M, _FARTHEST_M = 0.3, 4.0
_WIDEST_PX = 424  # of the image in which corners are sought
_MOST_CORNERS, _APART_PX, _CORNER_QUALITY = 220, 9, 0.01  # those that a tracker would take
_SOBEL = 1.0 / 1020.0  # of its gradients: a step from black to white is 1
_BLOCK_PX = 7  # around a corner, in which its texture is measured
_MIN_TEXTURE = 3e-5  # least eigenvalue of a corner's texture; less is noise
# its two eigenvalues: ratio up to which it is an edge, and from which on a corner
_EDGE_SHARE, _CORNER_SHARE = 0.15, 0.5
_ABOVE_NOISE = 5.0  # factor of the texture that the plainest tenth of an image does not exceed; noise reaches 3
_PLAIN_SHARE = 0.1
_FEWEST_POINTS = 6
_FLAT = 0.3  # ratio of the two smallest axes of a plane, by the noise of depth and of poses
_SHOWN = 0.15  # weight of a new look in the mean of corners
_FEWEST_CORNERS = 0.5  # a smaller mean is noise, or a corner that is not seen again
_COLUMNS = 9  # of a row of surface: place, normal, spread, area, corners
# from a heading to others, nearest first
_TURNS_RAD = np.deg2rad([0.0, *(sign * turn for turn in range(15, 181, 15) for sign in (1, -1))])
_MOMENTS = 10  # number, sum of x, y, z, sum of xx, xy, xz, yy, yz, zz


class LocalizabilityMap:
    """Cells of one map epoch. Not thread-safe; about 7 ms a frame.

    grid: of the occupancy map, whose box it covers. eye: the camera.
    """

    def __init__(self, grid: GridSpec, eye: Eye) -> None:
        upper_m = grid.origin_world_m + grid.resolution_m * np.array(grid.shape)
        self._grid = GridSpec.covering(grid.origin_world_m, upper_m, CELL_M)
        self._eye = eye
        self._map_epoch = 0
        self._begin()

    def _begin(self) -> None:
        count = math.prod(self._grid.shape)
        self._moments = np.zeros((count, _MOMENTS))
        self._facing = np.zeros((count, 3))  # sum of unit vectors to the camera
        self._area_m2 = np.zeros(count)
        self._corners = np.full(count, np.nan)
        self._row = np.full(count, -1)  # of a cell in _surface
        self._surface = np.zeros((0, _COLUMNS))
        self._cells = SurfaceCells.none(CELL_M)
        self._taken_s = -np.inf

    @property
    def cells(self) -> SurfaceCells:
        """All cells with surface."""
        return self._cells

    def add(self, posed: PosedFrame) -> bool:
        """Take a frame; return False if it adds nothing.

        It is too soon after another one, or its place is uncertain.
        """
        if posed.map_epoch != self._map_epoch:
            self._map_epoch = posed.map_epoch
            self._begin()
        if posed.unsure or posed.frame.stamp_s - self._taken_s < _SPACING_S:
            return False
        self._taken_s = posed.frame.stamp_s
        patches = _patches(posed.frame)
        points = posed.world_from_depth.apply(patches.points_m)
        index = self._grid.index(points)
        inside = self._grid.contains(index)
        if not inside.any():
            return False
        flat = np.ravel_multi_index(tuple(index[inside].T), self._grid.shape)
        changed = self._take(flat, points[inside], posed.world_from_depth.translation_m, patches.of(inside))
        self._describe(changed[self._moments[changed, 0] >= _FEWEST_POINTS])
        held = self._surface
        self._cells = SurfaceCells(CELL_M, held[:, :3], held[:, 3:6], held[:, 6], held[:, 7], held[:, 8])
        return True

    def sigma_m(self, world_from_body: Pose, pitch_down_rad: float) -> float:
        """Return how well the view of a level body shows its place, as view_sigmas() predicts it."""
        position, angles = world_from_body.translation_m[None], np.array([[world_from_body.yaw_rad(), pitch_down_rad]])
        return float(view_sigmas(self._cells, self._eye, position, angles).sigma_m[0])

    def seeing_yaw_rad(self, world_from_body: Pose, pitch_down_rad: float) -> float | None:
        """Return the nearest heading in which the view shows the place well.

        None if there is none.
        """
        turn_rad = _TURNS_RAD[:, None]
        position = np.tile(world_from_body.translation_m, (len(turn_rad), 1))
        angles = np.hstack([world_from_body.yaw_rad() + turn_rad, np.full_like(turn_rad, pitch_down_rad)])
        good = view_sigmas(self._cells, self._eye, position, angles).sigma_m < GOOD_M
        return math.remainder(float(angles[np.argmax(good), 0]), math.tau) if good.any() else None

    def _take(self, flat: IntArray, points: FloatArray, eye_m: FloatArray, patches: _Patches) -> IntArray:
        """Add patches (N,) of a view from eye_m (3,).

        flat (N,): numbers of their cells. points (N, 3): in world. Return the numbers of the cells that have changed.
        """
        cell, which, number = np.unique(flat, return_inverse=True, return_counts=True)

        def total(of: FloatArray) -> FloatArray:
            return np.asarray(np.bincount(which, of, len(cell)), dtype=np.float64)

        x, y, z = (points - self._grid.origin_world_m).T
        sums = (x, y, z, x * x, x * y, x * z, y * y, y * z, z * z)
        self._moments[cell] += np.stack((number, *(total(of) for of in sums)), axis=1)
        to_eye = eye_m - points
        to_eye /= np.linalg.norm(to_eye, axis=1, keepdims=True)
        self._facing[cell] += np.stack([total(of) for of in to_eye.T], axis=1)
        self._area_m2[cell] = np.maximum(self._area_m2[cell], total(patches.across_m2))
        known = np.isfinite(patches.corners)
        seen, shown = total(known.astype(np.float64)), total(np.where(known, patches.corners, 0.0))
        looked = cell[seen > 0.0]
        now, before = shown[seen > 0.0], self._corners[looked]
        self._corners[looked] = np.where(np.isnan(before), now, before + _SHOWN * (now - before))
        return np.asarray(cell)

    def _describe(self, cell: IntArray) -> None:
        """Write the rows of cells (N,) in the table of surface."""
        number, total = self._moments[cell, 0], self._moments[cell, 1:4]
        mean = total / number[:, None]
        squares = self._moments[cell][:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3) / number[:, None, None]
        values, axes = np.linalg.eigh(squares - mean[:, :, None] * mean[:, None, :])
        normal = axes[:, :, 0]
        normal = np.where(np.einsum("na,na->n", normal, self._facing[cell])[:, None] < 0.0, -normal, normal)
        uneven = np.clip(values[:, 0] / np.maximum(values[:, 1], 1e-9) - _FLAT, 0.0, 1.0) / 3.0
        corners = np.where(self._corners[cell] > _FEWEST_CORNERS, self._corners[cell], 0.0)  # NaN: not seen in colour
        rows = np.column_stack([self._grid.origin_world_m + mean, normal, uneven, self._area_m2[cell], corners])
        new = self._row[cell] < 0
        self._row[cell[new]] = len(self._surface) + np.arange(np.count_nonzero(new))
        self._surface = np.vstack([self._surface, rows[new]])
        self._surface[self._row[cell[~new]]] = rows[~new]

    @staticmethod
    def warm_up() -> None:
        """Compile every kernel."""
        view_information.warm_up()


class _Patches(NamedTuple):
    """Patches of a depth image.

    points_m (N, 3): their middles, in the frame of the depth imager. across_m2 (N,): area across the view. corners (N,): number
    of corners that the colour image shows there, NaN outside it.
    """

    points_m: FloatArray
    across_m2: FloatArray
    corners: FloatArray

    def of(self, some: BoolArray) -> _Patches:
        """Return some of the patches (N,)."""
        return _Patches(self.points_m[some], self.across_m2[some], self.corners[some])


def _patches(frame: Frame) -> _Patches:
    """Return the patches of a frame."""
    lens = frame.depth_intrinsics
    step = max(round(_PATCH_SHARE * lens.width), 1)
    half = step // 2
    depth_m = frame.depth_m[half::step, half::step]
    v, u = np.nonzero((depth_m > _NEAREST_M) & (depth_m < _FARTHEST_M))
    z = depth_m[v, u].astype(np.float64)
    across = np.stack(((half + step * u - lens.cx) / lens.fx, (half + step * v - lens.cy) / lens.fy, np.ones(len(z))), axis=1)
    points_m = across * z[:, None]
    return _Patches(points_m, z**2 * step**2 / (lens.fx * lens.fy), _corners(frame, points_m, step / lens.fx))


def _corners(frame: Frame, points_m: FloatArray, patch_rad: float) -> FloatArray:
    """Return the number of corners of each patch (N,), NaN outside the colour image.

    points_m (N, 3): middles of the patches. patch_rad: their width. A corner counts for less the more it is an edge.
    """
    lens = frame.rgb_intrinsics
    scale = min(_WIDEST_PX / lens.width, 1.0)
    grey = cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2GRAY)
    grey = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1.0 else grey
    x, y, z = frame.rgb_from_depth.apply(points_m).T
    column = np.rint(scale * (lens.fx * x / z + lens.cx)).astype(int)
    row = np.rint(scale * (lens.fy * y / z + lens.cy)).astype(int)
    height, width = grey.shape
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    patch_px = max(round(scale * lens.fx * patch_rad), 1)
    found = np.full(len(points_m), np.nan)
    counts = cv2.boxFilter(_corner_image(grey), -1, (patch_px, patch_px), normalize=False, borderType=cv2.BORDER_CONSTANT)
    found[inside] = counts[row[inside], column[inside]]
    return found


def _corner_image(grey: ByteArray) -> Float32Array:
    """Return an image that is not zero at the corners that a tracker would follow.

    It is 1 there, or less where a corner is nearly an edge.
    """
    out = np.zeros(grey.shape, np.float32)
    found = cv2.goodFeaturesToTrack(grey, _MOST_CORNERS, _CORNER_QUALITY, _APART_PX, blockSize=3)
    if found is not None:
        column, row = np.rint(found.reshape(-1, 2)).astype(int).T
        weaker, stronger = _texture(grey)
        least = max(_MIN_TEXTURE, _ABOVE_NOISE * float(np.quantile(weaker[::8, ::8], _PLAIN_SHARE)))
        ratio = weaker[row, column] / np.maximum(stronger[row, column], _MIN_TEXTURE)
        share = np.clip((ratio - _EDGE_SHARE) / (_CORNER_SHARE - _EDGE_SHARE), 0.0, 1.0)
        out[row, column] = np.where(weaker[row, column] > least, share**2, 0.0)
    return out


def _texture(grey: ByteArray) -> tuple[Float32Array, Float32Array]:
    """Return the lesser and the greater eigenvalue (h, w) of the texture around each pixel.

    Texture: mean products of the gradients.
    """
    dx, dy = (cv2.Sobel(grey, cv2.CV_32F, right, 1 - right, scale=_SOBEL) for right in (1, 0))
    xx, xy, yy = (cv2.boxFilter(product, -1, (_BLOCK_PX, _BLOCK_PX)) for product in (dx * dx, dx * dy, dy * dy))
    middle, off = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    return np.asarray(middle - off), np.asarray(middle + off)
