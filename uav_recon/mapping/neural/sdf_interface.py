"""What a learned field can be asked, whoever learned it."""

from __future__ import annotations

from typing import Protocol

from uav_recon.types.frames import Float32Array


class SdfField(Protocol):
    """Distance and colour at any point of the box."""

    def distance_m(self, points: Float32Array) -> Float32Array:
        """Signed distance (N,) at points (N, 3) float32, positive in the air."""
        ...

    def rgb(self, points: Float32Array) -> Float32Array:
        """Colour (N, 3) in 0..1 at points (N, 3) float32."""
        ...
