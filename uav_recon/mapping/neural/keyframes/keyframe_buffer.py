"""Buffer of the kept views: rays, depth images, and eviction when memory is full."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

from uav_recon.mapping.neural.keyframes.depth_visibility import DepthImage, DepthVisibility
from uav_recon.mapping.neural.keyframes.eviction_policy import EvictionPolicy
from uav_recon.mapping.neural.keyframes.keyframe_validation import FEWEST_RAYS
from uav_recon.mapping.neural.keyframes.normal_prior import open_prior
from uav_recon.mapping.neural.keyframes.ray_buffer import MAX_VIEWS, RayBuffer, ViewRays
from uav_recon.mapping.neural.keyframes.ray_records import pixel_stride, ray_records
from uav_recon.types.camera import PosedFrame
from uav_recon.types.frames import AnyArray, BoolArray, Float32Array, FloatArray

KEPT_VIEWS = MAX_VIEWS * 3 // 4  # number of views kept when memory is full
SOME_RAYS = 6500  # rays of a view that are used to determine what it shows
# validation of a view: other views, points of it, rays of each other view
VALIDATION_VIEWS = 64
VALIDATION_POINTS = 600
VALIDATION_RAYS = 40


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A keyframe as stored in the buffer.

    records (R, COLUMNS): its rays (see ray_records); ends: end points of some of them; image: its depth, with lens, pose and
    noise; ray_rad: angle between neighbouring rays.
    """

    records: AnyArray
    ends: ViewRays
    image: DepthImage
    ray_rad: float


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
        self._ray_rad: list[float] = []

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for a checkpoint, without the arrays of the views.

        See arrays() and put_back().
        """
        return self.__dict__ | {"_prior": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._prior = open_prior(self._prior_model)

    @property
    def full(self) -> bool:
        """True if keep() must make room for the next view."""
        return self.replay.count == MAX_VIEWS

    def arrays(self, index: int) -> dict[str, AnyArray]:
        """Return copies of the arrays of a view, which a checkpoint stores separately."""
        return {"records": self.replay.records(index).copy(), "depth_mm": self.images.image(index)}

    def put_back(self, index: int, arrays: dict[str, AnyArray]) -> None:
        """Restore the arrays from arrays() after unpickling.

        Raises ValueError or KeyError if they do not belong to this view.
        """
        self.replay.put_back(index, arrays["records"])
        self.images.put_back(index, arrays["depth_mm"])

    def develop(self, keyframe: PosedFrame) -> View | None:
        """Return the view of a keyframe; None if it has fewer than FEWEST_RAYS rays."""
        frame = keyframe.frame
        lens = frame.depth_intrinsics
        sigma = self._noise_px / (lens.fx * self._baseline_m)
        most = self.replay.rays_per_view()
        records = ray_records(frame, sigma, most, self._random)
        if len(records) < FEWEST_RAYS:
            return None
        if self._prior is not None:
            self._prior.fill(records, frame)
        rotation, position = keyframe.world_from_depth.rotation(), keyframe.world_from_depth.translation_m
        image = (frame.depth_m, lens.pinhole_px(), rotation, position, sigma)
        ends = self.replay.rays(records[:SOME_RAYS], rotation, position, sigma)
        return View(records, ends, image, pixel_stride(lens, most) / lens.fx)

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
        _, _, rotation, position, sigma = view.image
        self.remembered.add(number, position, view.ends.points[0])
        self.replay.add(view.records, rotation, position, sigma)
        self._ray_rad.append(view.ray_rad)
        self.images.add(*view.image)

    def place(self, index: int, rotation: FloatArray, position: FloatArray) -> None:
        """Change the pose of a view: world_from_depth as rotation (3, 3) and position (3,)."""
        self.replay.place(index, rotation, position)
        self.images.place(index, rotation, position)

    def sync_image_poses(self) -> None:
        """Set the poses of the depth images to the refined poses of the rays."""
        for index in range(self.replay.count):
            self.images.place(index, *self.replay.pose(index))

    def footprint_m(self, index: int, sigma_m: Float32Array) -> Float32Array:
        """Return the spacing (N,) of a view's rays where their depth has a noise of sigma_m (N,)."""
        spacing: Float32Array = np.sqrt(sigma_m / self.replay.views.inverse_depth_sigma[index]) * self._ray_rad[index]
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
        self._ray_rad = list(compress(self._ray_rad, which))
