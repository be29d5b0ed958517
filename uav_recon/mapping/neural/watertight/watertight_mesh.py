"""Watertight mesh of the room: learned surface where measured, closed by lids elsewhere.

A lattice over the whole box is solid except where a depth image measured through it; near measured surface the field gives
the values. Its zero level set (marching cubes: Lorensen and Cline 1987, in the variant of Lewiner et al. 2003) has no
border. Lids separate air from space without observation. Faces not supported by a measurement are marked: they are not part
of the model and are excluded from all evaluation figures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.mapping.neural.sdf_interface import SdfField
from uav_recon.mapping.neural.surface.extraction import (
    EVIDENCE_CELL_M,
    MAX_VERTEX_DISTANCE_M,
    MIN_END_POINTS,
    confirmed_by_depth,
)
from uav_recon.mapping.neural.surface.surface_nets import ABSENT, EDGE, node_points, wanted_nodes
from uav_recon.mapping.neural.training_data import TrainingData
from uav_recon.types.frames import AnyArray, BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from uav_recon.types.maps import TriangleMesh

THROUGH_M = 0.06  # a cell is air if an image measured a depth this far behind its centre
MAX_NODES = 600_000_000  # maximum size of the lattice, 10 bytes per node
SPECK_NODES = 64  # a connected part of solid or of air with fewer nodes is noise
CLIP_VOXELS = 2.0  # larger values carry no information
MIN_VOXELS = 0.02  # minimum absolute distance of a node, so that no two vertices coincide


class MeshResolutionError(Exception):
    """Raised for a voxel that is too fine for the box; the text gives the finest that fits."""


@dataclass(frozen=True, slots=True, eq=False)
class ClosedMesh:
    """A watertight mesh with a mark for observed faces.

    vertices_world (V, 3) float64; faces (F, 3) int64, counter-clockwise seen from the air; normals (V, 3) float32, towards
    the air; rgb (V, 3) uint8; uncertainty (V,) float32; observed (F,) bool.
    """

    vertices_world: FloatArray
    faces: IntArray
    normals: Float32Array
    rgb: ByteArray
    uncertainty: Float32Array
    observed: BoolArray

    def seen(self) -> TriangleMesh:
        """Return the observed part, which is the model."""
        used, faces = np.unique(self.faces[self.observed], return_inverse=True)
        return TriangleMesh(self.vertices_world[used], faces.reshape(-1, 3), self.rgb[used], self.uncertainty[used])

    def seen_share(self) -> float:
        """Return the observed share of the area."""
        a, b, c = (self.vertices_world[self.faces[:, corner]] for corner in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        return float(area[self.observed].sum() / max(float(area.sum()), 1e-12))


def check_size(gathered: TrainingData, voxel_m: float) -> None:
    """Check that the lattice over the box fits. Raises MeshResolutionError if it does not."""
    extent_m = np.array(gathered.evidence.count.shape) * EVIDENCE_CELL_M
    min_m = float((extent_m.prod() / MAX_NODES) ** (1 / 3))
    if voxel_m < min_m:
        raise MeshResolutionError(f"so large a box can be meshed with voxels of {min_m:.3f} m at the finest")


def closed_mesh(field: SdfField, gathered: TrainingData, voxel_m: float) -> ClosedMesh:
    """Return the watertight mesh of a field.

    Raises MeshResolutionError if the lattice is too large.
    """
    values = _lattice(field, gathered, voxel_m)
    vertices, faces = _level_set(values, gathered.evidence.origin_m, voxel_m)
    normals = vertex_normals(vertices, faces)
    at, facing = vertices.astype(np.float32), normals.astype(np.float32)
    seen: BoolArray = np.abs(field.distance_m(at)) < MAX_VERTEX_DISTANCE_M
    seen &= gathered.evidence.holding()(at) & confirmed_by_depth(gathered.evidence, gathered.images, at, facing)
    return ClosedMesh(
        vertices,
        faces,
        facing,
        np.clip(np.round(field.rgb(at) * 255.0), 0, 255).astype(np.uint8),
        gathered.uncertainty.at(at).astype(np.float32),
        np.asarray(seen[faces].all(axis=1), dtype=np.bool_),
    )


def vertex_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return area-weighted unit normals (V, 3)."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    normal = np.cross(b - a, c - a)
    total = np.stack(
        [np.bincount(faces.ravel(), np.repeat(normal[:, axis], 3), minlength=len(vertices)) for axis in range(3)], axis=1
    )
    unit: FloatArray = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-15)
    return unit


def _lattice(field: SdfField, gathered: TrainingData, voxel_m: float) -> Float32Array:
    """Return distances in voxels, positive in the air, at lattice nodes; the border is solid.

    Node (i, j, k) lies at origin + voxel * (i - 1, j - 1, k - 1).
    """
    check_size(gathered, voxel_m)
    near = gathered.evidence.near(MIN_END_POINTS)
    nodes = wanted_nodes(near, gathered.evidence.origin_m, EVIDENCE_CELL_M, voxel_m)
    shape = [int(n) * EDGE for n in nodes.slot.shape]
    points, mask = node_points(nodes)
    nodes.values[mask] = np.clip(field.distance_m(points) / voxel_m, -CLIP_VOXELS, CLIP_VOXELS)
    cells = [
        np.minimum((np.arange(n) * voxel_m / EVIDENCE_CELL_M).astype(int), most - 1)
        for n, most in zip(shape, near.shape, strict=True)
    ]
    seen = _seen_air(gathered)[np.ix_(*cells)]
    values = np.where(seen, np.float32(CLIP_VOXELS), np.float32(-CLIP_VOXELS))
    for (i, j, k), block in zip(nodes.blocks * EDGE, nodes.values, strict=True):
        held = block < ABSENT
        values[i : i + EDGE, j : j + EDGE, k : k + EDGE][held] = block[held]
    _drop_pieces(values, seen)
    small = np.abs(values) < MIN_VOXELS
    values[small] = np.where(values[small] < 0.0, -MIN_VOXELS, MIN_VOXELS)
    return np.pad(values, 1, constant_values=-CLIP_VOXELS)


def _seen_air(gathered: TrainingData) -> BoolArray:
    """Return the cells of the evidence lattice that a depth image measured through."""
    shape = gathered.evidence.count.shape
    centre = gathered.evidence.origin_m + (np.indices(shape).reshape(3, -1).T + 0.5) * EVIDENCE_CELL_M
    return gathered.images.looked_through(centre.astype(np.float32), THROUGH_M).reshape(shape)


def _drop_pieces(values: Float32Array, seen: BoolArray) -> None:
    """Fill air that was not observed, and remove specks of solid."""
    air = values > 0.0
    label, count = _pieces(air)
    known = np.zeros(count + 1, dtype=np.bool_)
    known[np.unique(label[air & seen])] = True
    known &= np.bincount(label.ravel(), minlength=count + 1) >= SPECK_NODES
    air &= known[label]
    values[~air & (values > 0.0)] = -CLIP_VOXELS
    label, count = _pieces(~air)
    values[~air & (np.bincount(label.ravel(), minlength=count + 1) < SPECK_NODES)[label]] = CLIP_VOXELS


def _pieces(mask: BoolArray) -> tuple[AnyArray, int]:
    from scipy.ndimage import label

    labels, count = label(mask)
    return labels, int(count)


def _level_set(values: Float32Array, origin_m: FloatArray, voxel_m: float) -> tuple[FloatArray, IntArray]:
    from skimage.measure import marching_cubes

    vertices, faces, _, _ = marching_cubes(values, 0.0, gradient_direction="descent")
    return origin_m + (vertices.astype(np.float64) - 1.0) * voxel_m, faces.astype(np.int64)
