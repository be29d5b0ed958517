"""Views of the last seconds, each with its nearest returns."""

from __future__ import annotations

from dataclasses import dataclass

from uav_recon.types.frames import Float32Array, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class RecentViews:
    """V views, oldest first.

    stamp_s: (V,) capture time. depth_from_world: (V, 3, 3) rotation. place_world: (V, 3) position of the depth imager.
    body_world: (V, 3) position of the body's centre. range_m: (V, rows, columns) nearest return of each cell, NaN where it
    holds too few. half_tan: (2,) tangents of half the horizontal and half the vertical angle of view.
    """

    stamp_s: FloatArray
    depth_from_world: FloatArray
    place_world: FloatArray
    body_world: FloatArray
    range_m: Float32Array
    half_tan: FloatArray
