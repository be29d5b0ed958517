"""Door leaves, half open: where they stand, and the width that they leave free.

Seen from above, lengths in metres. Angles in radians, 0 for a closed door.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.scene import texture
from sitl.scene.flat_builder import Area
from sitl.scene.furniture import Piece
from sitl.scene.mesh import Mesh
from sitl.scene.primitives import MeshBuilder

LEAF_M = 0.04  # thickness
GAP_M = 0.01  # between a leaf and the floor, the lintel, and walls that it does not hang on
F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Doorway:
    """An opening in a wall: where it is, and the axis along which it is passed, 0 = x."""

    area: Area
    across: int

    @property
    def width_m(self) -> float:
        """Distance between its jambs."""
        begin, end = self.area.span(1 - self.across)
        return end - begin


@dataclass(frozen=True)
class DoorLeaf:
    """A leaf as wide as its doorway, hinged at the edge of a jamb and the face of the wall.

    corners: (4, 2) hinge, tip, tip and hinge on the side of the opening. swept: what it passes over between closed and open.
    """

    corners: F64
    swept: Area

    @property
    def footprint(self) -> Area:
        """The axis-aligned box around it."""
        return Area(*map(float, (*self.corners.min(axis=0), *self.corners.max(axis=0))))

    def mesh(self, builder: MeshBuilder, paint: texture.Paint, height_m: float) -> Mesh:
        """Return the leaf in a doorway of a height."""
        hinge, tip, _, inner = self.corners
        along, width_m = tip - hinge, float(np.linalg.norm(tip - hinge))
        left = float(along[0] * (inner - hinge)[1] - along[1] * (inner - hinge)[0]) > 0.0
        low, high = (0.0, LEAF_M) if left else (-LEAF_M, 0.0)
        box = builder.box((0.0, low, GAP_M), (width_m, high, height_m - GAP_M), paint)
        return Piece(box, 0.0, 0.0).placed(float(hinge[0]), float(hinge[1]), math.atan2(along[1], along[0]))


def open_leaf(doorway: Doorway, room: Area, hinge_low: bool, angle_rad: float) -> DoorLeaf:
    """Return the leaf of a doorway that is open into a room by an angle.

    hinge_low: at the jamb of lower coordinate. room: one of the two that the doorway joins.
    """
    across, (begin, end) = doorway.across, doorway.area.span(1 - doorway.across)
    hinge, closed = (begin, 1.0) if hinge_low else (end, -1.0)
    face, inwards = _face(doorway, room)
    tip = doorway.width_m * np.array([math.cos(angle_rad) * closed, math.sin(angle_rad) * inwards])
    inner = LEAF_M * np.array([math.sin(angle_rad) * closed, -math.cos(angle_rad) * inwards])
    corners = np.array([hinge, face]) + np.stack([np.zeros(2), tip, tip + inner, inner])  # along the wall, through it
    reach = face + inwards * (doorway.width_m + LEAF_M)
    along = min(begin, float(corners[:, 0].min())), max(end, float(corners[:, 0].max()))
    swept = Area.across(across, min(face, reach), max(face, reach), *along)
    return DoorLeaf(corners[:, ::-1] if across == 0 else corners, swept)


def free_width_m(leaf: DoorLeaf, doorway: Doorway, room: Area, hinge_low: bool) -> float:
    """Return the least width of the way past an open leaf, 0 if it does not fit into the room.

    The way leads between the leaf and the other jamb, then between the leaf and the sides of the room.
    """
    across, (face, inwards) = doorway.across, _face(doorway, room)
    (low, high), (begin, end) = doorway.area.span(across), doorway.area.span(1 - across)
    (side0, side1), (near, far) = room.span(1 - across), room.span(across)
    along, through = leaf.corners[:, 1 - across], leaf.corners[:, across]
    in_room, inner = leaf.corners[(through - face) * inwards > GAP_M], room.grown(-GAP_M)
    if any(inner.distance_m(float(x), float(y)) > 0.0 for x, y in in_room):
        return 0.0
    jamb, side = (end, side1) if hinge_low else (begin, side0)
    wall = Area.across(across, low, high, min(jamb, side), max(jamb, side))  # beyond the other jamb
    edges = np.array([[low, jamb], [high, jamb]])
    ways = (
        doorway.width_m,
        float(np.abs(along - side).min()),
        float(np.abs(through - (far if inwards > 0.0 else near)).min()),
        min(wall.distance_m(float(x), float(y)) for x, y in leaf.corners),
        float(leaf_distance_m(leaf, edges if across == 0 else edges[:, ::-1]).min()),
    )
    return min(ways)


def leaf_distance_m(leaf: DoorLeaf, points: F64) -> F64:
    """Return the distances (N,) of points (N, 2) to the edges of a leaf."""
    starts = leaf.corners
    edges = np.roll(starts, -1, axis=0) - starts
    relative = points[:, None] - starts
    share = np.clip((relative * edges).sum(axis=2) / (edges**2).sum(axis=1), 0.0, 1.0)
    found: F64 = np.linalg.norm(relative - share[..., None] * edges, axis=2).min(axis=1)
    return found


def _face(doorway: Doorway, room: Area) -> tuple[float, float]:
    """Return the face of the wall towards a room, and the direction into it."""
    low, high = doorway.area.span(doorway.across)
    return (high, 1.0) if room.span(doorway.across)[0] >= high - 1e-6 else (low, -1.0)
