"""Ghost voxels: what is left in the map of a body that moved through the scene and is gone."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
Points = NDArray[np.float32]
GHOSTS = "voxels of the person left"
HOLES = "unknown voxels left by the person"
NEAR_VOXELS = 2.0  # a voxel no farther from the true surface may be that surface, seen with the errors of camera and pose
_UNKNOWN, _OCCUPIED = 0, 2


def ghost_voxels(known: Any, before: Any, places_m: F64, half_m: tuple[float, float, float], surface_m: Points) -> int:
    """Return the number of occupied voxels that the body has left in a map.

    They lie inside the swept volume and off the true surface. before: the states of the same voxels before the body came, None
    if the map is younger; what was occupied then is not the body's. places_m: (N, 3) centres of the upright box with half
    extents half_m. surface_m: (M, 3) points of the scene's surface.
    """
    return _left(known, before, _OCCUPIED, places_m, half_m, surface_m)


def hole_voxels(known: Any, before: Any, places_m: F64, half_m: tuple[float, float, float], surface_m: Points) -> int:
    """Return the number of unknown voxels there that were known before, for the record."""
    return _left(known, before, _UNKNOWN, places_m, half_m, surface_m)


def _left(known: Any, before: Any, state: int, places_m: F64, half_m: tuple[float, float, float], surface_m: Points) -> int:
    others = np.ones(known.state.shape, dtype=np.bool_) if before is None else before != state
    centres = known.grid.centre(np.argwhere((known.state == state) & others))
    half = np.array(half_m)
    if not len(places_m) or not len(centres):
        return 0
    low, high = places_m.min(axis=0) - half, places_m.max(axis=0) + half
    if len(surface_m):  # what is seen outside the scene is a wall of it, seen with errors
        low, high = np.maximum(low, surface_m.min(axis=0)), np.minimum(high, surface_m.max(axis=0))
    box = (low, high)
    centres = centres[((centres >= box[0]) & (centres <= box[1])).all(axis=1)]
    inside = [bool((np.abs(places_m - centre) <= half).all(axis=1).any()) for centre in centres]
    near_m = NEAR_VOXELS * known.grid.resolution_m
    around = surface_m[((surface_m >= box[0] - near_m) & (surface_m <= box[1] + near_m)).all(axis=1)]
    return sum(int(_is_off(centre, around, near_m)) for centre in centres[np.array(inside, dtype=np.bool_)])


def _is_off(centre_m: F64, surface_m: Points, near_m: float) -> bool:
    """Return whether a position is farther than near_m from each point (M, 3) of a surface."""
    return not len(surface_m) or float(np.linalg.norm(surface_m - centre_m, axis=1).min()) > near_m
