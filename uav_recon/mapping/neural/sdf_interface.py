"""Interface of a learned field, common to all back ends."""

from __future__ import annotations

from typing import Protocol

from uav_recon.types.frames import Float32Array


class SdfField(Protocol):
    """Signed distance and colour at any point of the box."""

    def distance_m(self, points: Float32Array) -> Float32Array:
        """Return the signed distances (N,) at points (N, 3) float32, positive in the air."""
        ...

    def rgb(self, points: Float32Array) -> Float32Array:
        """Return the colours (N, 3) in 0..1 at points (N, 3) float32."""
        ...
