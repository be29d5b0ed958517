"""Errors of a camera from views of a walk, by the joint adjustment of the mapper."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uav_recon.app.step_display import Report, no_report
from uav_recon.config import CameraConfig, MapperConfig
from uav_recon.localization.calibration.calibration_filter import Elements
from uav_recon.mapping.neural.neural_mapper import ADJUST_VIEWS, NeuralMapper
from uav_recon.types.camera import PosedFrame
from uav_recon.types.frames import FloatArray

# box that is adjusted: these percentiles of the measured points, and padding
PERCENTILES = (0.5, 99.5)
PADDING_M = 0.3
LARGEST_M3 = 3000.0  # a surfel map of this box takes 220 MB; a larger box is cut to a cube of this volume
STRIDE_PX = 8  # pixels between the points that define the box


def errors_from_views(
    views: Sequence[PosedFrame], camera: CameraConfig, *, own_poses: bool, report: Report = no_report
) -> Elements | None:
    """Return the errors of the depth and colour imager; None from too few views.

    At least ADJUST_VIEWS must be usable. views: as the camera reported them. own_poses: their poses come from the depth images,
    which then show neither delay nor mount nor scale of depth. Blocks for about 0.4 s per view; report(done, total) is called
    before each.
    """
    if len(views) < ADJUST_VIEWS:
        return None
    low_m, high_m = walked_box(views)
    mapper = NeuralMapper(MapperConfig(), low_m, high_m, camera.depth_noise_px, camera.baseline_m, own_poses=own_poses)
    for number, view in enumerate(views):
        report(number, len(views))
        mapper.add(view)
    if mapper.views < ADJUST_VIEWS:
        return None
    mapper.training_data()
    found = [errors for errors in (mapper.camera_errors, mapper.colour_errors) if errors is not None]
    return tuple((name, *known) for errors in found for name, known in errors.elements().items())


def walked_box(views: Sequence[PosedFrame]) -> tuple[FloatArray, FloatArray]:
    """Return the corners (3,) of a box around the cameras and what they show.

    Its volume is at most LARGEST_M3.
    """
    place_m = np.stack([view.world_from_depth.translation_m for view in views])
    low_m, high_m = np.percentile(np.concatenate([place_m, *map(_points, views)]), PERCENTILES, axis=0)
    low_m, high_m = np.minimum(low_m, place_m.min(axis=0)) - PADDING_M, np.maximum(high_m, place_m.max(axis=0)) + PADDING_M
    if np.prod(high_m - low_m) > LARGEST_M3:  # a hall, or a pose far away
        middle_m, reach_m = np.median(place_m, axis=0), 0.5 * float(np.cbrt(LARGEST_M3))
        low_m, high_m = np.maximum(low_m, middle_m - reach_m), np.minimum(high_m, middle_m + reach_m)
    return low_m, high_m


def _points(view: PosedFrame) -> FloatArray:
    """Return some of the points (N, 3) that a view measured, in world."""
    depth_m = view.frame.depth_m[::STRIDE_PX, ::STRIDE_PX]
    bearing = view.frame.depth_intrinsics.bearings()[::STRIDE_PX, ::STRIDE_PX]
    found = np.isfinite(depth_m)
    return view.world_from_depth.apply(bearing[found] * depth_m[found, None])
