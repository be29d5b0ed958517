"""Neural mapper: learns a signed distance field from keyframes, extracts surface and mesh."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from uav_recon.config import MapperConfig, UncertaintyName
from uav_recon.mapping.neural.keyframes.colour_adjustment import ColourAdjustment
from uav_recon.mapping.neural.keyframes.estimated_errors import EstimatedErrors
from uav_recon.mapping.neural.keyframes.exposure_compensation import ExposureCompensation
from uav_recon.mapping.neural.keyframes.joint_adjustment import JointAdjustment
from uav_recon.mapping.neural.keyframes.keyframe_buffer import KeyframeBuffer
from uav_recon.mapping.neural.keyframes.keyframe_validation import (
    FEWEST_VIEWS,
    ContradictionVote,
    RejectCounts,
    RejectReason,
    padded_box,
    pose_reject_reason,
    reject_reason,
)
from uav_recon.mapping.neural.keyframes.pose_refinement import PoseRefinement
from uav_recon.mapping.neural.keyframes.ray_records import in_rows
from uav_recon.mapping.neural.keyframes.surfels import Surfels
from uav_recon.mapping.neural.sdf_interface import SdfField
from uav_recon.mapping.neural.sdf_numba.ray_rendering import render_rays
from uav_recon.mapping.neural.sdf_numba.sdf_field import NumbaSdfField
from uav_recon.mapping.neural.surface.calibration_variance import CalibratedAgreement, CalibrationVariance
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
from uav_recon.types.argument_checks import require_box, require_kind, require_number
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame
from uav_recon.types.camera_calibration import CameraCalibration
from uav_recon.types.frames import AnyArray, BoolArray, Float32Array, FloatArray
from uav_recon.types.maps import SurfaceElements, TriangleMesh
from uav_recon.types.pose import Pose
from uav_recon.types.rgbd_camera import Camera

ALIGN_AT = (0.0, 0.2, 0.4)  # shares of the polish steps at which the poses are refined
ALIGN_ROUNDS = 3  # for training_data(), over all views at once
# all poses and the errors of the camera are adjusted together at this number of views, and then at each growth by a share
ADJUST_VIEWS = 6
ADJUST_GROWTH = 0.25
STALE_M = 0.002  # what was measured is counted again if the adjustment moves it by more
STALE_RANGE_M = 3.0  # range at which that is judged
FINAL_RATE = 0.1  # the learning rate falls to this share during the polish


class NeuralMapper:
    """The mapper without its process. Single-threaded, repeatable for a seed.

    box_min_m, box_max_m (3,): bounding box of the room in world. depth_noise_px: disparity noise of the depth image as
    delivered. baseline_m: stereo baseline. own_poses: the poses come from the depth images. uncertainties: all uncertainty
    measures by name. uncertainty: the measure given to surface elements, chosen by config.uncertainty. camera_errors: what all
    views show of the camera, None before ADJUST_VIEWS of them; colour_errors: of its colour imager against depth, None also if
    they show too little. The constructor raises PriorError (see normal_prior).
    """

    def __init__(
        self,
        config: MapperConfig,
        box_min_m: FloatArray,
        box_max_m: FloatArray,
        depth_noise_px: float,
        baseline_m: float,
        *,
        own_poses: bool = False,
    ) -> None:
        self._config = config
        self._noise_px = depth_noise_px
        self._baseline_m = baseline_m
        self._own_poses = own_poses
        low, high = padded_box(box_min_m, box_max_m)
        self._low = low.astype(np.float32)
        self._high = high.astype(np.float32)
        self._stream = np.array([config.seed], dtype=np.uint64)
        self._keyframe_buffer = KeyframeBuffer(depth_noise_px, baseline_m, config.prior_model, config.seed)
        self._replay = self._keyframe_buffer.replay
        self._colour_adjustment = ColourAdjustment()
        self.colour_errors: EstimatedErrors | None = None
        self.align_views = self.learn_gains = True
        self.refusals = RejectCounts()
        self.steps = 0
        self.map_epoch = 0
        self._begin(config.uncertainty)

    @classmethod
    def for_box(cls, box_min_m: ArrayLike, box_max_m: ArrayLike, camera: Camera, *, seed: int = 0) -> NeuralMapper:
        """Return a mapper for a box and a camera, with the defaults of the configuration.

        box_min_m, box_max_m (3,): bounding box of the room, in world, metres. Raises ValueError for an invalid box.
        """
        low, high = require_box(box_min_m, box_max_m)
        require_kind("camera", camera, Camera)
        return cls(MapperConfig(seed=seed), low, high, camera.depth_noise_px, camera.baseline_m)

    def _begin(self, uncertainty: UncertaintyName) -> None:
        """Start an empty map that contains no view yet."""
        low, high = self._low.astype(np.float64), self._high.astype(np.float64)
        self._taken = 0
        self._contradiction = ContradictionVote()
        self._measured_cells = MeasuredCells(low, high)
        self._live = IncrementalSurface(self._measured_cells, self._config.surface_voxel_m)
        self._patches = Surfels(low, high)
        self._alignment = PoseRefinement(self._patches)
        self._adjustment = JointAdjustment(self._patches, own_poses=self._own_poses)
        self._adjust_at = ADJUST_VIEWS
        self.camera_errors: EstimatedErrors | None = None
        self._exposure = ExposureCompensation(self._patches)
        self._information = DepthInformation(low, high)
        self._colour_error = ColourError(low, high)
        self._learner = NumbaTrainingStep(self._low, self._high, self._config.seed, self._stream, self._colour_error)
        self._agreement = MeasuredAgreement(low, high)
        self._calibration_variance = CalibrationVariance(low, high)
        self.uncertainties = self._measures()
        self.uncertainty = self.uncertainties[uncertainty]

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for a checkpoint, without the arrays of the views.

        See view_arrays() and put_back().
        """
        return self.__dict__ | {"uncertainties": None, "uncertainty": self._chosen()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.uncertainties = self._measures()
        self.uncertainty = self.uncertainties[state["uncertainty"]]

    @property
    def field(self) -> NumbaSdfField:
        """The current field; repose() replaces it."""
        return self._learner.field

    @property
    def views(self) -> int:
        """Number of keyframes taken."""
        return self._keyframe_buffer.remembered.taken

    def training_data(self) -> TrainingData:
        """Refine all poses again and return the training data for another training.

        The data shares its arrays with this mapper and changes with it.
        """
        self._judge()
        for _ in range(ALIGN_ROUNDS):
            self._adjust()
        self._keyframe_buffer.sync_images()
        return TrainingData(
            self._low, self._high, self._replay, self._measured_cells, self._keyframe_buffer.images, self.uncertainty
        )

    @property
    def kept(self) -> list[int]:
        """Numbers of the views that are still replayed, ascending."""
        return self._keyframe_buffer.remembered.numbers

    @property
    def skipped(self) -> int:
        """Number of steps skipped because their gradient was not finite."""
        return self._learner.skipped

    def view_arrays(self, index: int) -> dict[str, AnyArray]:
        """Return copies of the arrays of the index-th kept view.

        A checkpoint stores them separately.
        """
        return self._keyframe_buffer.arrays(index)

    def put_back(self, index: int, arrays: dict[str, AnyArray]) -> None:
        """Restore the arrays from view_arrays() after unpickling.

        Raises ValueError or KeyError if they do not belong to this view.
        """
        self._keyframe_buffer.put_back(index, arrays)
        self._keyframe_buffer.paint(index, self._colour_adjustment.value)

    def add(self, keyframe: PosedFrame, number: int | None = None) -> bool:
        """Add a keyframe; returns False if it is rejected (counted and logged by ``refusals``).

        number: the number of the keyframe, greater than all before; by default the number of keyframes taken. For the
        reasons of a rejection see keyframe_validation.
        """
        reason = reject_reason(keyframe, self._low, self._high)
        if reason is None:
            try:
                reason = self._add_view(keyframe, self.views if number is None else number)
            except MemoryError:
                reason = RejectReason.OUT_OF_MEMORY
        if reason is not None:
            self.refusals.note(reason)
        return reason is None

    def _add_view(self, keyframe: PosedFrame, number: int) -> RejectReason | None:
        """Add a view unless it contradicts the others; returns the reason of a rejection.

        A MemoryError leaves the map unchanged.
        """
        if self._replay.count and keyframe.map_epoch != self.map_epoch:
            return RejectReason.EPOCH
        if not self._replay.count:
            self._alignment.calibration = keyframe.calibration
        view = self._keyframe_buffer.develop(keyframe, self._alignment.calibration, self._colour_adjustment.value)
        if view is None:
            return RejectReason.EMPTY
        if self.views >= FEWEST_VIEWS and self._contradiction.is_contradiction(
            keyframe.frame.depth_intrinsics, self._keyframe_buffer.votes(view)
        ):
            return RejectReason.DISAGREES
        if self._keyframe_buffer.full:
            self._keep(self._keyframe_buffer.most_useful())
        taken, kept = self.views, np.ones(self._replay.count, dtype=np.bool_)
        try:
            self._keyframe_buffer.add(view, number)
            if self.waiting == 1:  # no older view is waiting
                self._take()
        except MemoryError:
            self._keep(kept)
            self._keyframe_buffer.remembered.taken = taken
            raise
        self.map_epoch = keyframe.map_epoch
        return None

    @property
    def waiting(self) -> int:
        """Number of kept views that are not part of the map yet.

        It is above zero after repose(), until learn_waiting().
        """
        return self._replay.count - self._taken

    def repose(self, world_from_depth: Mapping[int, Pose], map_epoch: int) -> None:
        """Start a new map with new poses of the views, given by number.

        Views without a pose, or with a pose outside the box, are dropped and counted by ``refusals``. This is cheap:
        learn_waiting() does the work, a few views per call. Views that are added in between wait for their turn.
        """
        self.map_epoch = map_epoch
        calibration, errors = self._alignment.calibration, self._adjustment.value
        self._begin(self._chosen())
        self._alignment.calibration, self._adjustment.value = calibration, errors
        self._keep(np.array([self._placed(world_from_depth.get(number)) for number in self.kept], dtype=np.bool_))
        for view, number in enumerate(self.kept):
            self._keyframe_buffer.place(view, world_from_depth[number], self._alignment.calibration)

    def _placed(self, world_from_depth: Pose | None) -> bool:
        """Return True if the pose of a view in the new map is valid; else count the reason."""
        reason = (
            RejectReason.UNPLACED if world_from_depth is None else pose_reject_reason(world_from_depth, self._low, self._high)
        )
        if reason is not None:
            self.refusals.note(reason)
        return reason is None

    def learn_waiting(self, views: int) -> int:
        """Add at most ``views`` waiting views with their training steps; returns the number left.

        Each view gets the steps that it gets in flight.
        """
        for _ in range(min(views, self.waiting)):
            try:
                self._take()
                self.train(self._config.steps_per_view)
            except MemoryError:
                self.refusals.note(RejectReason.OUT_OF_MEMORY)
                self._keep(np.arange(self._replay.count) != self._taken - 1)
        return self.waiting

    def _take(self) -> None:
        """Add the next waiting view to the map."""
        replay, number = self._replay, self._taken
        self._taken += 1
        self._alignment.add(replay, self._keyframe_buffer.captured[number])
        if self.align_views:
            self._alignment.meet(replay)
        if self.learn_gains:
            self._exposure.meet(replay)
        self._measure(number)
        if self.align_views and self._taken >= self._adjust_at:
            self._adjust_at = math.ceil(self._taken * (1.0 + ADJUST_GROWTH))
            self._adjust()

    def _adjust(self) -> None:
        """Adjust poses and errors of the camera over all views, and count again what moved by it."""
        before = self._alignment.calibration
        self.camera_errors = self._adjustment.adjust(self._alignment, self._replay)
        self._calibration_variance.covariance = self.camera_errors.covariance
        self._adjust_colours()
        self._count_again(before)

    def _judge(self) -> None:
        """Let views that are held out decide whether errors of the camera are corrected."""
        if self.align_views and self.camera_errors is not None:
            before = self._alignment.calibration
            self._adjustment.judge(self._alignment, self._replay)
            self._count_again(before)

    def _count_again(self, before: CameraCalibration) -> None:
        """Count again what all views measure, if that moved."""
        if before.difference_m(self._alignment.calibration, STALE_RANGE_M) <= STALE_M:
            return
        for each in (self._information, self._agreement, self._calibration_variance, self._measured_cells):
            each.clear()
        for number in range(self._taken):
            self._measure(number)

    def _adjust_colours(self) -> None:
        """Estimate the errors of the colour imager from all views, and colour their rays again."""
        buffer = self._keyframe_buffer
        buffer.sync_images()
        views = slice(self._taken)
        self.colour_errors = self._colour_adjustment.adjust(
            buffer.captured[views], buffer.pictures[views], self._replay, buffer.images
        )
        for view in range(self._replay.count):
            buffer.paint(view, self._colour_adjustment.value)
        self._alignment.move_all(self._replay)

    def _measure(self, number: int) -> None:
        """Count what a view measures."""
        replay = self._replay
        sigma, (rotation, position) = float(replay.views.inverse_depth_sigma[number]), replay.pose(number)
        view = replay.rays(in_rows(replay.records(number)), rotation, position, sigma, replay.views.stretch[number])
        for points in view.points:
            self._learner.cover(points)
        self._information.add(view.points[0], view.cosine, view.sigma_m)
        self._agreement.add(view.points[0], view.normal, view.sigma_m)
        self._calibration_variance.add(view.points[0], view.normal, self._keyframe_buffer.captured[number].given)
        footprint_m = self._keyframe_buffer.footprint_m(number, view.sigma_m)
        self._measured_cells.add(position, view.points[0], view.normal, view.sigma_m, footprint_m)
        self._live.touch(view.points[0])

    def train(self, steps: int, rate: float = 1.0) -> float:
        """Run training steps; returns the last loss (0 before the first view).

        rate: share of the full learning rate.
        """
        loss = 0.0
        for _ in range(steps if self._taken else 0):
            loss = self._learner.step(self._replay.views, self._taken, rate)
            self.steps += 1
        return loss

    def train_for(self, seconds: float) -> int:
        """Run training steps for a time; returns their number, 0 before the first view.

        The result depends on the machine's speed. Raises ValueError for a time that is negative or not finite.
        """
        require_number("seconds", seconds, 0.0)
        before, end_s = self.steps, time.perf_counter() + seconds
        while self._taken and time.perf_counter() < end_s:
            self.train(1)
        return self.steps - before

    def polish(self, steps: int) -> None:
        """Train for a number of steps with a learning rate that falls to FINAL_RATE.

        The falling rate averages out the remaining noise. The pose refinement at ALIGN_AT removes most of the effect of pose
        errors.
        """
        self.learn_waiting(self.waiting)
        self._judge()
        aligned_at = {int(steps * share) for share in ALIGN_AT}
        for n in range(steps if self.views else 0):
            if self.align_views and n in aligned_at:
                self._adjust()
            self.train(1, FINAL_RATE ** ((n + 1) / steps))

    @property
    def element_spacing_m(self) -> float:
        """Distance between neighbouring elements of surface()."""
        return self._config.surface_voxel_m

    def surface(self) -> SurfaceElements:
        """Return the elements of the surface; none before the first view.

        The elements are up to date where new views measured surface, elsewhere slightly older.
        """
        self._live.refresh(self.field, self.uncertainty)
        return self._live.elements(self.views, self.map_epoch)

    def all_surface_elements(self) -> SurfaceElements:
        """Return the elements of the whole surface, extracted from the current field."""
        voxel_m = self._config.surface_voxel_m
        return surface_elements(self.field, self._measured_cells, self.uncertainty, voxel_m, self.views, self.map_epoch)

    def whole_surface(self, voxel_m: float) -> WholeSurface:
        """Return all zero crossings of the field, also where nothing was measured.

        Used to evaluate an uncertainty measure.
        """
        return whole_surface(self.field, self._measured_cells, voxel_m)

    def mesh(self, voxel_m: float | None = None) -> TriangleMesh:
        """Return the triangles of the surface, extracted from the current field.

        voxel_m: edge of the extraction grid; by default config.mesh_voxel_m, 2 cm.
        """
        voxel_m = self._config.mesh_voxel_m if voxel_m is None else voxel_m
        self._keyframe_buffer.sync_images()
        return triangle_mesh(
            self.field, self._measured_cells, self.uncertainty, voxel_m, self._keyframe_buffer.images, self.painted()
        )

    def painted(self) -> ColourFusedField:
        """Return the field with colours fused from the replayed views.

        Uses the current poses and exposures of the views.
        """
        return ColourFusedField(self.field, self._replay, self._low, self._high)

    def look(self, field: SdfField, origin: Float32Array, direction: Float32Array) -> Float32Array:
        """Return the colours (N, 3) in 0..1 along rays, rendered through a field.

        origin (N, 3) in world; direction (N, 3): unit vectors. field: the learned field or painted().
        """
        return render_rays(field, self._measured_cells.holding(), origin, direction)[0]

    def positions(self) -> FloatArray:
        """Return the current depth camera positions of the views in world, (V, 3)."""
        return self._replay.views.position[: self._replay.count].astype(np.float64)

    def corrections(self) -> FloatArray:
        """Return the pose corrections of the views (V, 6).

        Translation and rotation vector about the camera, in world, relative to the given poses.
        """
        return self._alignment.correction.copy()

    def log_gains(self) -> FloatArray:
        """Return the exposure gains of the views: log factors (V, 3) of rgb + TOE with zero mean."""
        return self._exposure.log_gain.copy()

    def warm_up(self) -> None:
        """Compile every kernel on a small separate mapper."""
        config = self._config.model_copy(update={"prior_model": None})
        small = NeuralMapper(config, np.zeros(3), np.ones(3), self._noise_px, self._baseline_m)
        for _ in range(2):  # a pose is refined from the second view on
            small.add(_wall())
            small.train(1)
        small.polish(1)
        small.surface()
        small.mesh(0.05)
        small.painted().rgb(np.full((2, 3), 0.5, dtype=np.float32))  # the mesh may be empty
        small._keep(small._keyframe_buffer.most_useful())

    def _keep(self, which: BoolArray) -> None:
        """Drop all views except those selected by a mask (V,).

        The field keeps what was learned from the dropped views.
        """
        self._keyframe_buffer.keep(which)
        taken = which[: self._taken]
        self._taken = int(which[: self._taken].sum())
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
            "agreement": CalibratedAgreement(self._agreement, self._calibration_variance),
        }


def _wall() -> PosedFrame:
    lens = Intrinsics.from_fov(64, 48, 1.2, 0.9)
    depth = np.full((48, 64), 0.5, dtype=np.float32)
    frame = Frame(0.0, 0, depth, lens, np.full((48, 64, 3), 128, dtype=np.uint8), lens, Pose.identity())
    return PosedFrame(frame, Pose.from_rotation_vector(np.array([0.0, np.pi / 2, 0.0]), np.array([0.2, 0.5, 0.5])))
