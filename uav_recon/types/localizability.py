"""Surface as a camera uses it to tell where it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.types.frames import FloatArray, frozen


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceCells:
    """Cells of a map that hold surface.

    size_m: edge of a cell. position_world (N, 3): mean of the surface in a cell. normal_world (N, 3): unit, towards the camera
    that saw it. spread (N,): share 0 to 1/3 of the normals in each direction across the mean one; 1/3 where surfaces face all
    ways. area_m2 (N,): of the surface. corners (N,): number of corners that an image of the cell shows.
    """

    size_m: float
    position_world: FloatArray
    normal_world: FloatArray
    spread: FloatArray
    area_m2: FloatArray
    corners: FloatArray

    def __post_init__(self) -> None:
        for name in ("position_world", "normal_world", "spread", "area_m2", "corners"):
            object.__setattr__(self, name, frozen(np.asarray(getattr(self, name), dtype=np.float64)))

    @staticmethod
    def none(size_m: float) -> SurfaceCells:
        """Return no cells."""
        return SurfaceCells(size_m, np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0), np.empty(0))
