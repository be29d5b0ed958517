"""Buffer of the kept views: rays, depth images, and eviction when memory is full."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

from uav_recon.mapping.neural.keyframes.captured_view import CapturedView
from uav_recon.mapping.neural.keyframes.colour_image import ColourImage
from uav_recon.mapping.neural.keyframes.colour_projection import paint
from uav_recon.mapping.neural.keyframes.depth_visibility import DepthImage, DepthVisibility
from uav_recon.mapping.neural.keyframes.eviction_policy import EvictionPolicy
from uav_recon.mapping.neural.keyframes.keyframe_validation import FEWEST_RAYS
from uav_recon.mapping.neural.keyframes.normal_prior import open_prior
from uav_recon.mapping.neural.keyframes.ray_buffer import MAX_VIEWS, RayBuffer, ViewRays
from uav_recon.mapping.neural.keyframes.ray_records import pixel_stride, ray_records
from uav_recon.mapping.neural.keyframes.surfels import RAYS_USED
from uav_recon.types.camera import PosedFrame
from uav_recon.types.camera_calibration import CameraCalibration
from uav_recon.types.frames import AnyArray, BoolArray, Float32Array, FloatArray
from uav_recon.types.pose import Pose

KEPT_VIEWS = MAX_VIEWS * 3 // 4  # number of views kept when memory is full
SOME_RAYS = 6500  # rays of a view that are used to determine what it shows
# validation of a view: other views, points of it, rays of each other view
VALIDATION_VIEWS = 64
VALIDATION_POINTS = 600
VALIDATION_RAYS = 40


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A keyframe as stored in the buffer, with depth as the camera reported it.

    records (R, COLUMNS): its rays (see ray_records); ends: end points of some of them; image: its depth, with lens, pose and
    noise; picture: its colour image.
    """

    captured: CapturedView
    records: AnyArray
    ends: ViewRays
    image: DepthImage
    picture: ColourImage


class KeyframeBuffer:
    """Views by index, in order of arrival. EvictionPolicy has their numbers, which never change.

    depth_noise_px, baseline_m: see NeuralMapper; seed: of the choice of rays. The constructor raises PriorError (see
    normal_prior).
    """

    def __init__(self, depth_noise_px: float, baseline_m: float, prior_model: Path | None, seed: int) -> None:
        self._noise_px = depth_noise_px
        self._baseline_m = baseline_m
        self._prior_model = prior_model
        self._random = np.random.default_rng(seed)
        self._prior = open_prior(prior_model)
        self.replay = RayBuffer()
        self.images = DepthVisibility()
        self.remembered = EvictionPolicy()
        self.captured: list[CapturedView] = []
        self.pictures: list[ColourImage] = []

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for a checkpoint, without the arrays of the views.

        See arrays() and put_back().
        """
        return self.__dict__ | {"_prior": None, "pictures": [picture.without_pixels() for picture in self.pictures]}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._prior = open_prior(self._prior_model)

    @property
    def full(self) -> bool:
        """True if keep() must make room for the next view."""
        return self.replay.count == MAX_VIEWS

    def arrays(self, index: int) -> dict[str, AnyArray]:
        """Return copies of the arrays of a view, which a checkpoint stores separately."""
        return {
            "records": self.replay.records(index).copy(),
            "depth_mm": self.images.image(index),
            "jpeg": self.pictures[index].jpeg,
        }

    def put_back(self, index: int, arrays: dict[str, AnyArray]) -> None:
        """Restore the arrays from arrays() after unpickling.

        Raises ValueError or KeyError if they do not belong to this view.
        """
        self.replay.put_back(index, arrays["records"])
        self.images.put_back(index, arrays["depth_mm"])
        self.pictures[index] = replace(self.pictures[index], jpeg=arrays["jpeg"])

    def develop(self, keyframe: PosedFrame, calibration: CameraCalibration, colour_errors: FloatArray) -> View | None:
        """Return the view of a keyframe; None if it has fewer than FEWEST_RAYS rays.

        calibration: errors of the camera as known now, which replace those that the keyframe was corrected for. colour_errors
        (9,): of its colour imager (see colour_projection).
        """
        applied = keyframe.calibration
        frame = replace(keyframe.frame, depth_m=applied.reported_depth_m(keyframe.frame.depth_m))
        given = applied.motion(keyframe.world_from_depth, keyframe.velocity_mps, keyframe.rate_radps)
        lens = frame.depth_intrinsics
        sigma = self._noise_px / (lens.fx * self._baseline_m)
        most = self.replay.rays_per_view()
        records, measured = ray_records(frame, sigma, most, self._random)
        if len(records) < FEWEST_RAYS:
            return None
        if self._prior is not None:
            self._prior.fill(records, frame)
        picture = ColourImage.of(frame)
        paint(records, calibration.stretch, picture.decoded(), picture.imager(given), colour_errors)
        pose = calibration.pose(given)
        where = (pose.rotation(), pose.translation_m, sigma, calibration.stretch)
        ends = self.replay.rays(records[:SOME_RAYS], *where)
        ray_rad = pixel_stride(lens, most) / lens.fx
        captured = CapturedView(frame.stamp_s, given, applied, measured[:RAYS_USED].copy(), ray_rad)
        return View(captured, records, ends, (frame.depth_m, lens.pinhole_px(), *where), picture)

    def votes(self, view: View) -> Float32Array:
        """Return the votes (N,) of kept views on a new view's points, and of it on theirs.

        Takes about 1 ms. See DepthVisibility.votes().
        """
        ends = view.ends
        some = np.flatnonzero(ends.cosine >= 0.0)[:VALIDATION_POINTS]  # those with a normal; rays are in random order
        others = self.images.votes(ends.points[0, some], ends.normal[some], VALIDATION_VIEWS)
        itself = DepthVisibility()
        itself.add(*view.image)
        return np.concatenate([others, itself.votes(*self.replay.some_points(VALIDATION_VIEWS, VALIDATION_RAYS))])

    def add(self, view: View, number: int) -> None:
        """Add a view with a number greater than all before. Raises IndexError if full."""
        self.remembered.add(number, view.image[3], view.ends.points[0])
        self.replay.add(view.records, *view.image[2:])
        self.captured.append(view.captured)
        self.pictures.append(view.picture)
        self.images.add(*view.image)

    def place(self, index: int, world_from_depth: Pose, calibration: CameraCalibration) -> None:
        """Change the given pose of a view.

        world_from_depth: as a keyframe has it, with what that keyframe was corrected for. calibration: errors as known now.
        """
        self.captured[index] = self.captured[index].reposed(world_from_depth)
        pose = calibration.pose(self.captured[index].given)
        self.replay.place(index, pose.rotation(), pose.translation_m, calibration.stretch)
        self.sync_image(index)

    def sync_images(self) -> None:
        """Give the depth images the refined poses and lenses of the rays."""
        for index in range(self.replay.count):
            self.sync_image(index)

    def sync_image(self, index: int) -> None:
        """Give a depth image the pose and lens of its rays."""
        self.images.place(index, *self.replay.pose(index), self.replay.views.stretch[index])

    def paint(self, index: int, colour_errors: FloatArray) -> None:
        """Give the rays of a view the colours of its image, with errors (9,) of the colour imager.

        Takes about 5 ms.
        """
        picture, imager = self.pictures[index], self.pictures[index].imager(self.captured[index].given)
        paint(self.replay.records(index), self.replay.views.stretch[index], picture.decoded(), imager, colour_errors)

    def footprint_m(self, index: int, sigma_m: Float32Array) -> Float32Array:
        """Return the spacing (N,) of a view's rays where their depth has a noise of sigma_m (N,)."""
        spacing: Float32Array = np.sqrt(sigma_m / self.replay.views.inverse_depth_sigma[index]) * self.captured[index].ray_rad
        return spacing.astype(np.float32)

    def most_useful(self) -> BoolArray:
        """Return a mask (V,) of the KEPT_VIEWS views to keep when room must be made."""
        return self.remembered.most_useful(KEPT_VIEWS)

    def keep(self, which: BoolArray) -> None:
        """Drop all views except those selected by a mask (V,).

        Views beyond the end of the mask are dropped too.
        """
        for memory in (self.remembered, self.replay, self.images):
            memory.keep(which)
        self.captured = list(compress(self.captured, which))
        self.pictures = list(compress(self.pictures, which))
