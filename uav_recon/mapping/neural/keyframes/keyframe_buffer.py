"""The views that are kept: their rays, their depth images, and which of them go when memory is full."""

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

KEPT_VIEWS = MAX_VIEWS * 3 // 4  # when memory is full
SOME_RAYS = 6500  # of a view, to see what it shows
ASKED_VIEWS, ASKED_POINTS, ASKED_RAYS = 64, 600, 40  # whether a view fits: so many others, on it and on each of them


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A keyframe as it is kept. records (R, COLUMNS): its rays (see rays); ends: where some of them end; image: its depth,
    with lens, pose and noise; ray_rad: angle between neighbouring rays.
    """

    records: AnyArray
    ends: ViewRays
    image: DepthImage
    ray_rad: float


class KeyframeBuffer:
    """Views by index, in the order in which they came; Remembered knows the numbers that outlast a clearing-out.

    depth_noise_px, baseline_m: see Trainer; seed: of the choice of rays. Raises PriorError (see priors).
    """

    def __init__(self, depth_noise_px: float, baseline_m: float, prior_model: Path | None, seed: int) -> None:
        self._noise_px, self._baseline_m, self._prior_model = depth_noise_px, baseline_m, prior_model
        self._random = np.random.default_rng(seed)
        self._prior = open_prior(prior_model)
        self.replay, self.images, self.remembered = RayBuffer(), DepthVisibility(), EvictionPolicy()
        self._ray_rad: list[float] = []

    def __getstate__(self) -> dict[str, Any]:
        """For a checkpoint: all but what each view brought along; see arrays() and put_back()."""
        return self.__dict__ | {"_prior": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._prior = open_prior(self._prior_model)

    @property
    def full(self) -> bool:
        """Whether keep() must make room for the next view."""
        return self.replay.count == MAX_VIEWS

    def arrays(self, index: int) -> dict[str, AnyArray]:
        """What a view brought along and a checkpoint keeps apart; copies."""
        return {"records": self.replay.records(index).copy(), "depth_mm": self.images.image(index)}

    def put_back(self, index: int, arrays: dict[str, AnyArray]) -> None:
        """Undo arrays() after unpickling. Raises ValueError or KeyError if they are not of this view."""
        self.replay.put_back(index, arrays["records"])
        self.images.put_back(index, arrays["depth_mm"])

    def develop(self, keyframe: PosedFrame) -> View | None:
        """What a keyframe would bring; None if that is less than FEWEST_RAYS."""
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
        """What the views say of a new one's points, and it of theirs (N,). About 1 ms."""
        ends = view.ends
        some = np.flatnonzero(ends.cosine >= 0.0)[:ASKED_POINTS]  # those with a normal; rays are in random order
        others = self.images.votes(ends.points[0, some], ends.normal[some], ASKED_VIEWS)
        itself = DepthVisibility()
        itself.add(*view.image)
        return np.concatenate([others, itself.votes(*self.replay.some_points(ASKED_VIEWS, ASKED_RAYS))])

    def add(self, view: View, number: int) -> None:
        """Keep a view, known by a number greater than those before. Raises IndexError if full."""
        _, _, rotation, position, sigma = view.image
        self.remembered.add(number, position, view.ends.points[0])
        self.replay.add(view.records, rotation, position, sigma)
        self._ray_rad.append(view.ray_rad)
        self.images.add(*view.image)

    def place(self, index: int, rotation: FloatArray, position: FloatArray) -> None:
        """Hold a view to have been taken elsewhere: world_from_depth as rotation (3, 3) and position (3,)."""
        self.replay.place(index, rotation, position)
        self.images.place(index, rotation, position)

    def place_images(self) -> None:
        """Hold images to have been taken where alignment now holds their rays to start."""
        for index in range(self.replay.count):
            self.images.place(index, *self.replay.pose(index))

    def footprint_m(self, index: int, sigma_m: Float32Array) -> Float32Array:
        """Spacing (N,) of a view's rays where their depth has a noise of sigma_m (N,)."""
        spacing: Float32Array = np.sqrt(sigma_m / self.replay.views.inverse_depth_sigma[index]) * self._ray_rad[index]
        return spacing.astype(np.float32)

    def most_useful(self) -> BoolArray:
        """The KEPT_VIEWS among the views (V,) that should stay when room must be made."""
        return self.remembered.most_useful(KEPT_VIEWS)

    def keep(self, which: BoolArray) -> None:
        """Forget all views but some (V,), and whatever came after those."""
        for memory in (self.remembered, self.replay, self.images):
            memory.keep(which)
        self._ray_rad = list(compress(self._ray_rad, which))
