"""The mapper: from keyframes to a field, its surface, its mesh. One thread, repeatable for a seed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from uav_recon.config import MapperConfig, UncertaintyName
from uav_recon.mapping.neural.keyframes.exposure_compensation import ExposureCompensation
from uav_recon.mapping.neural.keyframes.keyframe_buffer import KeyframeBuffer
from uav_recon.mapping.neural.keyframes.keyframe_validation import (
    FEWEST_VIEWS,
    ContradictionVote,
    RejectCounts,
    RejectReason,
    padded,
    pose_reject_reason,
    reject_reason,
)
from uav_recon.mapping.neural.keyframes.pose_refinement import PoseRefinement
from uav_recon.mapping.neural.keyframes.ray_records import in_rows
from uav_recon.mapping.neural.keyframes.surfels import Surfels
from uav_recon.mapping.neural.sdf_interface import SdfField
from uav_recon.mapping.neural.sdf_numba.ray_rendering import render_rays
from uav_recon.mapping.neural.sdf_numba.sdf_field import NumbaSdfField
from uav_recon.mapping.neural.surface.colour_fusion import ColourFusedField
from uav_recon.mapping.neural.surface.extraction import (
    MeasuredCells,
    WholeSurface,
    surface_elements,
    triangle_mesh,
    whole_surface,
)
from uav_recon.mapping.neural.surface.incremental_surface import IncrementalSurface
from uav_recon.mapping.neural.surface.uncertainty import (
    ColourError,
    DepthInformation,
    MeasuredAgreement,
    NetworkColourSigma,
    ProductUncertainty,
    SurfaceUncertainty,
)
from uav_recon.mapping.neural.training_data import TrainingData
from uav_recon.mapping.neural.training_step import NumbaTrainingStep
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame
from uav_recon.types.frames import AnyArray, BoolArray, Float32Array, FloatArray
from uav_recon.types.maps import SurfaceElements, TriangleMesh
from uav_recon.types.pose import Pose

ALIGN_AT = (0.0, 0.2, 0.4)  # shares of the polish at which views are aligned
ALIGN_ROUNDS = 3  # for another learner, all views at once
FINAL_RATE = 0.1  # the polish ends at this share of the learning rate


class NeuralMapper:
    """The mapper without its process. box_min_m, box_max_m (3,): the room's box in world.

    depth_noise_px: disparity noise of the depth image as delivered; baseline_m: stereo baseline. uncertainties: all measures
    by name; uncertainty: the one that elements carry, by config.uncertainty. Raises PriorError (see priors).
    """

    def __init__(
        self, config: MapperConfig, box_min_m: FloatArray, box_max_m: FloatArray, depth_noise_px: float, baseline_m: float
    ) -> None:
        self._config, self._noise_px, self._baseline_m = config, depth_noise_px, baseline_m
        low, high = padded(box_min_m, box_max_m)
        self._low, self._high = low.astype(np.float32), high.astype(np.float32)
        self._stream = np.array([config.seed], dtype=np.uint64)
        self._album = KeyframeBuffer(depth_noise_px, baseline_m, config.prior_model, config.seed)
        self._replay = self._album.replay
        self.align_views = self.learn_gains = True
        self.refusals = RejectCounts()
        self.steps, self.map_epoch = 0, 0
        self._begin(config.uncertainty)

    def _begin(self, uncertainty: UncertaintyName) -> None:
        """A map of nothing, of which no view is part yet."""
        low, high = self._low.astype(np.float64), self._high.astype(np.float64)
        self._taken, self._doubt = 0, ContradictionVote()
        self._evidence = MeasuredCells(low, high)
        self._live = IncrementalSurface(self._evidence, self._config.surface_voxel_m)
        self._patches = Surfels(low, high)
        self._alignment, self._exposure = PoseRefinement(self._patches), ExposureCompensation(self._patches)
        self._information, self._colour_error = DepthInformation(low, high), ColourError(low, high)
        self._learner = NumbaTrainingStep(self._low, self._high, self._config.seed, self._stream, self._colour_error)
        self._agreement = MeasuredAgreement(low, high)
        self.uncertainties = self._measures()
        self.uncertainty = self.uncertainties[uncertainty]

    def __getstate__(self) -> dict[str, Any]:
        """For a checkpoint: all but what each view brought along; see view_arrays() and put_back()."""
        return self.__dict__ | {"uncertainties": None, "uncertainty": self._chosen()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.uncertainties = self._measures()
        self.uncertainty = self.uncertainties[state["uncertainty"]]

    @property
    def field(self) -> NumbaSdfField:
        """As it is now; repose() begins another."""
        return self._learner.field

    @property
    def views(self) -> int:
        """Keyframes taken so far."""
        return self._album.remembered.taken

    def gathered(self) -> TrainingData:
        """What the views brought, aligned with each other once more, for another learner; it changes with this trainer."""
        for _ in range(ALIGN_ROUNDS):
            self._alignment.refine(self._replay)
        self._album.place_images()
        return TrainingData(self._low, self._high, self._replay, self._evidence, self._album.images, self.uncertainty)

    @property
    def kept(self) -> list[int]:
        """Numbers of those that are still replayed, ascending."""
        return self._album.remembered.numbers

    @property
    def skipped(self) -> int:
        """Steps whose gradient was not finite, and which changed nothing."""
        return self._learner.skipped

    def view_arrays(self, index: int) -> dict[str, AnyArray]:
        """What the index-th kept view brought along and a checkpoint keeps apart; copies."""
        return self._album.arrays(index)

    def put_back(self, index: int, arrays: dict[str, AnyArray]) -> None:
        """Undo view_arrays() after unpickling. Raises ValueError or KeyError if they are not of this view."""
        self._album.put_back(index, arrays)

    def add(self, keyframe: PosedFrame, number: int | None = None) -> bool:
        """Take a keyframe. False (counted and logged by ``refusals``) if something is to be said against it (see intake).

        number: by which it is known, greater than those before; as many as were taken, if not given.
        """
        reason = reject_reason(keyframe, self._low, self._high)
        if reason is None:
            try:
                reason = self._learn_of(keyframe, self.views if number is None else number)
            except MemoryError:
                reason = RejectReason.MEMORY
        if reason is not None:
            self.refusals.note(reason)
        return reason is None

    def _learn_of(self, keyframe: PosedFrame, number: int) -> RejectReason | None:
        """Note everything that a view says, unless it contradicts the others. MemoryError leaves the map as it was."""
        if self._replay.count and keyframe.map_epoch != self.map_epoch:
            return RejectReason.EPOCH
        view = self._album.develop(keyframe)
        if view is None:
            return RejectReason.EMPTY
        if self.views >= FEWEST_VIEWS and self._doubt.rises(keyframe.frame.depth_intrinsics, self._album.votes(view)):
            return RejectReason.DISAGREES
        if self._album.full:
            self._keep(self._album.most_useful())
        taken, kept = self.views, np.ones(self._replay.count, dtype=np.bool_)
        try:
            self._album.add(view, number)
            if self.waiting == 1:  # no older view waits
                self._take()
        except MemoryError:
            self._keep(kept)
            self._album.remembered.taken = taken
            raise
        self.map_epoch = keyframe.map_epoch
        return None

    @property
    def waiting(self) -> int:
        """Views that are kept and not yet part of the map: after repose(), until relearn() took them."""
        return self._replay.count - self._taken

    def repose(self, world_from_depth: Mapping[int, Pose], map_epoch: int) -> None:
        """Begin the map anew with other poses of the views, by number. Those of which none, or none in the box, is given are
        forgotten and counted by ``refusals``. Cheap; relearn() does the work, in turns. Views that are added meanwhile wait
        for their turn.
        """
        self.map_epoch = map_epoch
        self._begin(self._chosen())
        self._keep(np.array([self._placed(world_from_depth.get(number)) for number in self.kept], dtype=np.bool_))
        for view, number in enumerate(self.kept):
            self._album.place(view, world_from_depth[number].rotation(), world_from_depth[number].translation_m)

    def _placed(self, world_from_depth: Pose | None) -> bool:
        """Whether a view can be where a new map says."""
        reason = (
            RejectReason.UNPLACED if world_from_depth is None else pose_reject_reason(world_from_depth, self._low, self._high)
        )
        if reason is not None:
            self.refusals.note(reason)
        return reason is None

    def relearn(self, views: int) -> int:
        """Take at most so many waiting views, with the steps that each had in flight; returns how many wait still."""
        for _ in range(min(views, self.waiting)):
            try:
                self._take()
                self.train(self._config.steps_per_view)
            except MemoryError:
                self.refusals.note(RejectReason.MEMORY)
                self._keep(np.arange(self._replay.count) != self._taken - 1)
        return self.waiting

    def _take(self) -> None:
        """Make the next waiting view part of the map."""
        replay, number = self._replay, self._taken
        self._taken += 1
        self._alignment.add(replay)
        if self.align_views:
            self._alignment.meet(replay)
        if self.learn_gains:
            self._exposure.meet(replay)
        sigma, (rotation, position) = float(replay.views.inverse_depth_sigma[number]), replay.pose(number)
        view = replay.rays(in_rows(replay.records(number)), rotation, position, sigma)
        for points in view.points:
            self._learner.cover(points)
        self._information.add(view.points[0], view.cosine, view.sigma_m)
        self._agreement.add(view.points[0], view.normal, view.sigma_m)
        footprint_m = self._album.footprint_m(number, view.sigma_m)
        position = replay.pose(number)[1]
        self._evidence.add(position, view.points[0], view.normal, view.sigma_m, footprint_m)
        self._live.touch(view.points[0])

    def train(self, steps: int, rate: float = 1.0) -> float:
        """Run steps; returns the last loss (0 before the first view). rate: share of the full learning rate."""
        loss = 0.0
        for _ in range(steps if self._taken else 0):
            loss = self._learner.step(self._replay.views, self._taken, rate)
            self.steps += 1
        return loss

    def polish(self, steps: int) -> None:
        """Align the views with each other and train on, with a learning rate that falls to FINAL_RATE.

        What remains of the noise averages out; the alignment takes away most of what poses did to it.
        """
        self.relearn(self.waiting)
        aligned_at = {int(steps * share) for share in ALIGN_AT}
        for n in range(steps if self.views else 0):
            if self.align_views and n in aligned_at:
                self._alignment.refine(self._replay)
            self.train(1, FINAL_RATE ** ((n + 1) / steps))

    @property
    def element_spacing_m(self) -> float:
        """Distance between neighbouring elements of surface()."""
        return self._config.surface_voxel_m

    def surface(self) -> SurfaceElements:
        """Elements of the surface; none before the first view. New where new views looked, elsewhere a little older."""
        self._live.refresh(self.field, self.uncertainty)
        return self._live.elements(self.views, self.map_epoch)

    def whole_room(self) -> SurfaceElements:
        """Elements of the whole surface as it is now."""
        voxel_m = self._config.surface_voxel_m
        return surface_elements(self.field, self._evidence, self.uncertainty, voxel_m, self.views, self.map_epoch)

    def whole_surface(self, voxel_m: float) -> WholeSurface:
        """Every place where the field changes its sign, also where nobody looked: to ask what an uncertainty says of it."""
        return whole_surface(self.field, self._evidence, voxel_m)

    def mesh(self, voxel_m: float) -> TriangleMesh:
        """Triangles of the surface as it is now."""
        self._album.place_images()
        return triangle_mesh(self.field, self._evidence, self.uncertainty, voxel_m, self._album.images, self.painted())

    def painted(self) -> ColourFusedField:
        """The field in the colours of the views that are replayed, at the poses and exposures that they have now."""
        return ColourFusedField(self.field, self._replay, self._low, self._high)

    def look(self, field: SdfField, origin: Float32Array, direction: Float32Array) -> Float32Array:
        """Colour (N, 3) in 0..1 seen along rays from origin (N, 3) in unit direction (N, 3), drawn through a field: this one
        as it was learned, or painted().
        """
        return render_rays(field, self._evidence.holding(), origin, direction)[0]

    def positions(self) -> FloatArray:
        """Where the views' depth imagers are now held to have been, world (V, 3)."""
        return self._replay.views.position[: self._replay.count].astype(np.float64)

    def corrections(self) -> FloatArray:
        """What alignment did to the given poses (V, 6): translation and rotation vector about the camera, world."""
        return self._alignment.correction.copy()

    def log_gains(self) -> FloatArray:
        """How each picture is brightened to agree with the others: log factors (V, 3) of rgb + TOE, their mean zero."""
        return self._exposure.log_gain.copy()

    def warm_up(self) -> None:
        """Compile every kernel, on a small trainer of its own."""
        config = self._config.model_copy(update={"prior_model": None})
        small = NeuralMapper(config, np.zeros(3), np.ones(3), self._noise_px, self._baseline_m)
        small.add(_wall())
        small.train(1)
        small.polish(1)
        small.surface()
        small.mesh(0.05)
        small._keep(small._album.most_useful())

    def _keep(self, which: BoolArray) -> None:
        """Forget all views but some (V,), in what is replayed and asked; the field keeps what they taught."""
        self._album.keep(which)
        taken, self._taken = which[: self._taken], int(which[: self._taken].sum())
        for part in (self._alignment, self._exposure, self._patches):
            part.keep(taken)

    def _chosen(self) -> UncertaintyName:
        return next(name for name, measure in self.uncertainties.items() if measure is self.uncertainty)

    def _measures(self) -> dict[UncertaintyName, SurfaceUncertainty]:
        return {
            "paper": NetworkColourSigma(self.field.colour_sigma),
            "colour": self._colour_error,
            "information": self._information,
            "product": ProductUncertainty(self._colour_error, self._information),
            "agreement": self._agreement,
        }


def _wall() -> PosedFrame:
    lens = Intrinsics.from_fov(64, 48, 1.2, 0.9)
    depth = np.full((48, 64), 0.5, dtype=np.float32)
    frame = Frame(0.0, 0, depth, lens, np.full((48, 64, 3), 128, dtype=np.uint8), lens, Pose.identity())
    return PosedFrame(frame, Pose.from_rotation_vector(np.array([0.0, np.pi / 2, 0.0]), np.array([0.2, 0.5, 0.5])))
