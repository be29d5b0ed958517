"""Colour adjustment: errors of the colour imager against depth, from all views.

Gauss-Newton on the brightness of points in all images that see them, with the brightness of each point eliminated (photometric
bundle adjustment: Alismail et al. 2016), from coarse images to fine ones. The unknowns are the same in every view. Views
that are held out decide whether the result, the one before or none is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.mapping.neural.keyframes.captured_view import CapturedView
from uav_recon.mapping.neural.keyframes.colour_image import ColourImage
from uav_recon.mapping.neural.keyframes.colour_projection import NEAREST_M, ColourImager, project, turned
from uav_recon.mapping.neural.keyframes.depth_visibility import DepthVisibility
from uav_recon.mapping.neural.keyframes.estimated_errors import EstimatedErrors
from uav_recon.mapping.neural.keyframes.ray_buffer import RayBuffer
from uav_recon.mapping.neural.keyframes.ray_sampling import TOE
from uav_recon.types.camera_calibration import COLOUR_ERROR_SIGMAS
from uav_recon.types.frames import BoolArray, Float32Array, FloatArray, IntArray

NAMES = tuple(COLOUR_ERROR_SIGMAS)
ELEMENTS = len(NAMES)
PRIOR_SIGMA: FloatArray = np.array(list(COLOUR_ERROR_SIGMAS.values()))
# added to the deviations: the poses of the views err by more than a pixel, and a shift looks like a rotation from far away
SYSTEMATIC_SIGMA: FloatArray = np.array([0.002, 0.002, *[np.deg2rad(0.12)] * 3, 0.0015, *[0.004] * 3])
POINTS = 12_000  # of all views together
# standard deviation of the blur of the images in pixels, one per iteration: of the first adjustment, and of later ones
FIRST_BLURS_PX = (4.0, 4.0, 2.0, 2.0, 1.0, 1.0)
BLURS_PX = (1.0, 1.0)
WORKING_WIDTH_PX = 480  # wider images are reduced
LEAST_WIDTH_PX = 64  # narrower images are not used
LEVEL_SCALE = 0.06  # difference of brightness with half weight, of a range of 1
LEVEL_SIGMA = 0.1  # standard deviation of a brightness: about 0.03, and neighbouring points err together
ROBUST_ROUNDS = 3
PATCH_M = 0.5  # points of one patch of surface err together
HELD_OUT = 5  # every fifth view is held out
FEWEST_SIGHTINGS = 2000


@dataclass(frozen=True, slots=True, eq=False)
class _Sightings:
    """Points and the views that see them, sorted by view.

    points (P, 3); patch (P,): its patch of surface; point (N,), view (N,).
    """

    points: Float32Array
    patch: IntArray
    point: IntArray
    view: IntArray

    @staticmethod
    def of(replay: RayBuffer, images: DepthVisibility, views: int) -> _Sightings:
        points, normals = replay.some_points(views, max(POINTS // views, 1))
        found = [np.flatnonzero(images.shown(view, points, normals)) for view in range(views)]
        _, patch = np.unique(np.floor(points / PATCH_M).astype(np.int64), axis=0, return_inverse=True)
        return _Sightings(
            points, patch.ravel(), np.concatenate(found), np.repeat(np.arange(views), [len(each) for each in found])
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Normal equations, scores (G, 9) of patches, and the cost of the views held out."""

    normal: FloatArray
    right: FloatArray
    scores: FloatArray
    held_out_cost: float


class ColourAdjustment:
    """Estimates the errors (9,) of the colour imager."""

    def __init__(self) -> None:
        self._blurs_px: tuple[float, ...] = FIRST_BLURS_PX
        self.value: FloatArray = np.zeros(ELEMENTS)

    def adjust(
        self, captured: list[CapturedView], pictures: list[ColourImage], replay: RayBuffer, images: DepthVisibility
    ) -> EstimatedErrors | None:
        """Estimate the errors; None if too few points are seen.

        images: at the poses of the rays. Takes 1 s for 120 views, the first time 2 s.
        """
        if any(picture.width_px < LEAST_WIDTH_PX for picture in pictures):
            return None
        seen = _Sightings.of(replay, images, len(captured))
        if len(seen.point) < FEWEST_SIGHTINGS:
            return None
        grey = [_grey(picture, replay.views.gain[view]) for view, picture in enumerate(pictures)]
        imagers = [p.imager(c.given, g.shape[1]) for p, c, g in zip(pictures, captured, grey, strict=True)]
        prior, value = np.diag(PRIOR_SIGMA**-2), self.value
        for blur_px in self._blurs_px:
            blurred = [_blurred(each, blur_px) for each in grey]
            now = _equations(seen, *_look(seen, blurred, imagers, replay, value))
            value = value + np.linalg.solve(now.normal + prior, now.right - prior @ value)
        candidates = (value, self.value, np.zeros(ELEMENTS))
        judged = [_equations(seen, *_look(seen, blurred, imagers, replay, each)) for each in candidates]
        best = min(range(len(judged)), key=lambda n: judged[n].held_out_cost)
        self.value, self._blurs_px = candidates[best], BLURS_PX if best == 0 else FIRST_BLURS_PX
        inverse = np.linalg.inv(judged[best].normal + prior)
        effect = judged[best].scores @ inverse
        covariance = effect.T @ effect + inverse @ prior @ inverse + np.diag(SYSTEMATIC_SIGMA**2)
        return EstimatedErrors(NAMES, self.value.copy(), covariance)


def _grey(picture: ColourImage, gain: Float32Array) -> Float32Array:
    """Return the brightness (h, w) at the mean exposure, of a range of about 1."""
    import cv2

    rgb = picture.decoded()
    height, width = rgb.shape[:2]
    if width > WORKING_WIDTH_PX:
        factor = -(-width // WORKING_WIDTH_PX)
        rgb = cv2.resize(rgb, (width // factor, height // factor), interpolation=cv2.INTER_AREA)
    level = cv2.transform(rgb.astype(np.float32), gain.astype(np.float64)[None] / (3.0 * 255.0))
    return np.asarray(level + np.float32(TOE * gain.mean()), dtype=np.float32)


def _blurred(level: Float32Array, sigma_px: float) -> Float32Array:
    import cv2

    return np.asarray(cv2.GaussianBlur(level, (0, 0), sigma_px), dtype=np.float32)


def _look(
    seen: _Sightings, levels: list[Float32Array], imagers: list[ColourImager], replay: RayBuffer, errors: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the brightness (N,) of sightings and its derivatives (N, 9) by the errors.

    NaN outside the image.
    """
    level, slope = np.full(len(seen.point), np.nan), np.zeros((len(seen.point), ELEMENTS))
    first = np.searchsorted(seen.view, np.arange(len(levels) + 1))
    for view, image in enumerate(levels):
        mine = slice(first[view], first[view + 1])
        points = seen.points[seen.point[mine]]
        _observe(image, points, *replay.pose(view), imagers[view], errors, level[mine], slope[mine])
    return level, slope


def _equations(seen: _Sightings, level: FloatArray, slope: FloatArray) -> _Equations:
    """Return the equations, with the level of each point eliminated."""
    known = np.flatnonzero(np.isfinite(level))
    known = known[np.argsort(seen.point[known], kind="stable")]
    point, level, slope, held = seen.point[known], level[known], slope[known], seen.view[known] % HELD_OUT == HELD_OUT - 1
    first = np.flatnonzero(np.diff(point, prepend=-1))
    whose = np.repeat(np.arange(len(first)), np.diff(first, append=len(point)))
    used: BoolArray = ~held
    weight, off = used.astype(np.float64), level
    for _ in range(ROBUST_ROUNDS):
        total = np.maximum(np.add.reduceat(weight, first), 1e-9)
        off = level - (np.add.reduceat(weight * level, first) / total)[whose]
        weight = used / (1.0 + (off / LEVEL_SCALE) ** 2)
    total = np.maximum(np.add.reduceat(weight, first), 1e-9)
    own = slope - (np.add.reduceat(weight[:, None] * slope, first) / total[:, None])[whose]
    pull = -own * (weight * off / LEVEL_SIGMA**2)[:, None]
    patch = seen.patch[point]
    scores = np.zeros((int(seen.patch.max()) + 1, ELEMENTS))
    for element in range(ELEMENTS):
        scores[:, element] = np.bincount(patch, pull[:, element], len(scores))
    judged = held & (np.add.reduceat(used.astype(np.float64), first)[whose] > 0.0)
    cost = float(np.log1p((off[judged] / LEVEL_SCALE) ** 2).mean()) if judged.any() else 0.0
    return _Equations((own * (weight / LEVEL_SIGMA**2)[:, None]).T @ own, pull.sum(axis=0), scores, cost)


@kernel
def _observe(
    image: Float32Array, points: Float32Array, rotation: FloatArray, position: FloatArray, imager: ColourImager,
    errors: FloatArray, level: FloatArray, slope: FloatArray,
) -> None:  # fmt: skip
    """Compute the brightness (N,) of points (N, 3) in an image, and its derivatives (N, 9).

    Both stay as they are for a point outside the image. Rotation (3, 3) and position (3,): world_from_depth.
    """
    height, width = image.shape
    q, at, turn = np.empty(3), np.empty(9), turned(errors)
    for n in range(points.shape[0]):
        x, y, z = points[n, 0] - position[0], points[n, 1] - position[1], points[n, 2] - position[2]
        for i in range(3):
            q[i] = rotation[0, i] * x + rotation[1, i] * y + rotation[2, i] * z
        project(q, imager, turn, errors, height, at)
        u, v, x, y, z = at[0], at[1], at[3], at[4], at[5]
        if z < NEAREST_M or not (u >= 1.0 and v >= 1.0 and u < width - 2.0 and v < height - 2.0):
            continue
        i, j = int(v), int(u)
        s, t = v - i, u - j
        a, b, c, d = image[i, j], image[i, j + 1], image[i + 1, j], image[i + 1, j + 1]
        level[n] = (1 - s) * ((1 - t) * a + t * b) + s * ((1 - t) * c + t * d)
        across = ((1 - s) * (b - a) + s * (d - c)) * imager.lens[0] / z
        down = ((1 - t) * (c - a) + t * (d - b)) * imager.lens[1] / z
        gx, gy = (1.0 + errors[5]) * across, (1.0 + errors[5]) * down  # by the point in the imager
        gz = -(gx * x + gy * y) / z
        moved = gx * at[6] + gy * at[7] + gz * at[8]
        slope[n, 0], slope[n, 1] = moved, moved * at[2]
        slope[n, 2], slope[n, 3], slope[n, 4] = gy * z - gz * y, gz * x - gx * z, gx * y - gy * x
        slope[n, 5] = across * x + down * y
        slope[n, 6], slope[n, 7], slope[n, 8] = -gx, -gy, -gz
