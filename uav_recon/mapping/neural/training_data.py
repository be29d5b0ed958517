"""Training data of a flight, shared by the training back ends."""

from __future__ import annotations

from dataclasses import dataclass

from uav_recon.mapping.neural.keyframes.depth_visibility import DepthVisibility
from uav_recon.mapping.neural.keyframes.ray_buffer import RayBuffer
from uav_recon.mapping.neural.surface.extraction import MeasuredCells
from uav_recon.mapping.neural.surface.uncertainty import SurfaceUncertainty
from uav_recon.types.frames import Float32Array


@dataclass(frozen=True, slots=True, eq=False)
class TrainingData:
    """Rays with their poses, the measured cells and the depth images.

    low_m, high_m (3,): the mapped box.
    """

    low_m: Float32Array
    high_m: Float32Array
    replay: RayBuffer
    evidence: MeasuredCells
    images: DepthVisibility
    uncertainty: SurfaceUncertainty
