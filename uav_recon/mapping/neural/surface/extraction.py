"""Surface extraction from the field, limited to surface that the camera measured.

Three gates reject surface that was not measured. Nodes are evaluated only near measured end points. The extracted surface
must agree with the measured normals. At least as many depth images must see it as look through it; where its cell contains
no end point, more must see it. So small holes are closed and sheets do not grow.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.mapping.neural.keyframes.depth_visibility import DepthVisibility
from uav_recon.mapping.neural.sdf_interface import SdfField
from uav_recon.mapping.neural.sdf_numba.sdf_field import NumbaSdfField
from uav_recon.mapping.neural.surface.node_distances import fill_distances
from uav_recon.mapping.neural.surface.surface_nets import net_vertices, surface_net, wanted_nodes
from uav_recon.mapping.neural.surface.uncertainty import Lattice, SurfaceUncertainty
from uav_recon.types.frames import AnyArray, BoolArray, Float32Array, FloatArray, IntArray
from uav_recon.types.maps import SurfaceElements, TriangleMesh

EVIDENCE_CELL_M = 0.05
FILL_M = 0.15  # maximum distance of filled surface from a measured point
EVIDENCE_SIGMA_M = 0.15  # a measurement with a larger sigma does not locate the surface
MIN_END_POINTS = 2  # minimum number of end points of a surface cell
MIN_SUPPORT = 0.1  # minimum ratio of measured normals for a surface to those against it
MAX_VERTEX_DISTANCE_M = 0.006  # a vertex with a larger distance belongs to the border of the band, not to the surface


class MeasuredCells:
    """Counts of measured end points on a 5 cm lattice, and measured orientations on a 10 cm one.

    The orientations are six sums: the components of the normals along each half axis. So both sides of a thin object are
    stored.
    """

    def __init__(self, box_min_m: FloatArray, box_max_m: FloatArray) -> None:
        self.origin_m = np.asarray(box_min_m, dtype=np.float64)
        extent = np.asarray(box_max_m, dtype=np.float64) - self.origin_m
        self.count = np.zeros(tuple(int(n) for n in np.ceil(extent / EVIDENCE_CELL_M)), dtype=np.int32)
        self._facing = Lattice(box_min_m, box_max_m, 2 * EVIDENCE_CELL_M, 6)

    def add(
        self,
        position_m: FloatArray,
        points: Float32Array,
        normal: Float32Array,
        sigma_m: Float32Array,
        footprint_m: Float32Array,
    ) -> None:
        """Count end points (N, 3) seen from position_m (3,).

        normal (N, 3): zero if unknown; sigma_m (N,): depth sigma; footprint_m (N,): distance to the next ray, perpendicular
        to the line of sight. Cells between the rays are counted too, on distant and slanted surface.
        """
        _count(self.count, self.origin_m, EVIDENCE_CELL_M, position_m, points, normal, sigma_m, footprint_m)
        self._facing.splat(points, _halves(normal))

    def clear(self) -> None:
        """Forget all end points."""
        self.count[:] = 0
        self._facing.clear()

    def near(self, least: int) -> BoolArray:
        """Return the cells within one cell of a cell with at least ``least`` end points."""
        return self.near_in(least, np.ones(self.count.shape, dtype=np.bool_))

    def near_in(self, least: int, cells: BoolArray) -> BoolArray:
        """Return near(), limited to some cells (nx, ny, nz)."""
        out = np.zeros(self.count.shape, dtype=np.bool_)
        _spread(self.count, least, cells, out)
        return out

    def contains_end_point(self, points: Float32Array) -> BoolArray:
        """Return True (N,) for points (N, 3) whose cell contains an end point."""
        return _within(self.count > 0, self.origin_m, points)

    def holding(self) -> Callable[[Float32Array], BoolArray]:
        """Return a function that selects the points (N, 3) near measured surface (N,).

        It uses the current counts.
        """
        near = self.near(MIN_END_POINTS)

        def holds(points: Float32Array) -> BoolArray:
            return _within(near, self.origin_m, points)

        return holds

    def contradicts(self, points: Float32Array, normal: Float32Array) -> BoolArray:
        """Return True (N,) where normals (N, 3) at points (N, 3) oppose the measured orientation."""
        for_it, against_it = _halves(normal), _halves(-normal)
        return self._facing.dot(points, for_it - np.float32(MIN_SUPPORT) * against_it) < 0.0


def _within(cells: BoolArray, origin_m: FloatArray, points: Float32Array) -> BoolArray:
    """Return True (N,) for points (N, 3) in marked cells (nx, ny, nz)."""
    cell = np.floor((points - origin_m) / EVIDENCE_CELL_M).astype(np.int64)
    inside = ((cell >= 0) & (cell < cells.shape)).all(axis=1)
    held = np.zeros(len(points), dtype=np.bool_)
    held[inside] = cells[tuple(cell[inside].T)]
    return held


def _halves(normal: Float32Array) -> Float32Array:
    """Return the non-negative components (N, 6) of normals (N, 3) along +x, +y, +z, -x, -y, -z."""
    halves: Float32Array = np.maximum(np.concatenate([normal, -normal], axis=1), np.float32(0.0))
    return halves


def confirmed_by_depth(
    evidence: MeasuredCells, images: DepthVisibility, points: Float32Array, normal: Float32Array
) -> BoolArray:
    """Return True (N,) for surface points supported by depth images and measured normals.

    The normals (N, 3) at points (N, 3) must agree with the measured orientation. More images must see the surface than look
    through it; an equal number is enough where an end point lies in its cell.
    """
    seen = images.votes(points, normal)
    supported: BoolArray = (seen > 0.0) | ((seen == 0.0) & evidence.contains_end_point(points))
    return supported & ~evidence.contradicts(points, normal)


def surface_elements(
    field: NumbaSdfField,
    evidence: MeasuredCells,
    uncertainty: SurfaceUncertainty,
    voxel_m: float,
    revision: int,
    map_epoch: int,
) -> SurfaceElements:
    """Return the elements on the surface net of a lattice; none before the first view.

    voxel_m: spacing of the lattice.
    """
    vertices, normals = extract(field, evidence, evidence.near(MIN_END_POINTS), voxel_m)
    keep = ~evidence.contradicts(vertices, normals)
    vertices, normals = vertices[keep], normals[keep]
    return SurfaceElements(
        vertices.astype(np.float64),
        normals.astype(np.float64),
        uncertainty.at(vertices).astype(np.float64),
        revision,
        map_epoch,
    )


def triangle_mesh(
    field: NumbaSdfField,
    evidence: MeasuredCells,
    uncertainty: SurfaceUncertainty,
    voxel_m: float,
    images: DepthVisibility,
    painted: SdfField,
) -> TriangleMesh:
    """Return the surface as triangles, where confirmed_by_depth().

    painted: field that gives the colours.
    """
    vertices, normals, quads = _extract(field, evidence, evidence.near(MIN_END_POINTS), voxel_m)
    for _ in range(2):  # surface nets round corners by a fraction of a voxel: move the vertices back onto the level set
        slip = np.clip(field.distance_m(vertices), -0.5 * voxel_m, 0.5 * voxel_m)
        vertices = (vertices - slip[:, None] * normals).astype(np.float32)
    keep = np.abs(field.distance_m(vertices)) < MAX_VERTEX_DISTANCE_M
    keep &= confirmed_by_depth(evidence, images, vertices, normals)
    quads = quads[keep[quads].all(axis=1)]
    quads = quads[_in_large_parts(quads, len(vertices))]
    used, quads = np.unique(quads, return_inverse=True)
    quads = quads.reshape(-1, 4)
    vertices = vertices[used]
    return TriangleMesh(
        vertices.astype(np.float64),
        _triangles(vertices, quads),
        np.clip(np.round(painted.rgb(vertices) * 255.0), 0, 255).astype(np.uint8),
        uncertainty.at(vertices).astype(np.float32),
    )


@dataclass(frozen=True, slots=True, eq=False)
class WholeSurface:
    """Vertices (V, 3) float32 in world, and a mask of those near measured surface (V,)."""

    vertices: Float32Array
    observed: BoolArray


def whole_surface(field: NumbaSdfField, evidence: MeasuredCells, voxel_m: float) -> WholeSurface:
    """Return the zero level set in the whole box, without any gate.

    Its observed part is what surface_elements() would return.
    """
    wanted = np.ones(evidence.count.shape, dtype=np.bool_)
    vertices, normals, _ = _extract(field, evidence, wanted, voxel_m)
    observed = evidence.holding()(vertices) & ~evidence.contradicts(vertices, normals)
    return WholeSurface(vertices, observed)


def extract(
    field: NumbaSdfField, evidence: MeasuredCells, wanted: BoolArray, voxel_m: float
) -> tuple[Float32Array, Float32Array]:
    """Return vertices (V, 3) and normals (V, 3) of the surface of the field in wanted cells."""
    nodes = wanted_nodes(wanted, evidence.origin_m, EVIDENCE_CELL_M, voxel_m)
    fill_distances(field, nodes)
    return net_vertices(nodes)


def _extract(
    field: NumbaSdfField, evidence: MeasuredCells, wanted: BoolArray, voxel_m: float
) -> tuple[Float32Array, Float32Array, IntArray]:
    nodes = wanted_nodes(wanted, evidence.origin_m, EVIDENCE_CELL_M, voxel_m)
    fill_distances(field, nodes)
    return surface_net(nodes)


def _triangles(vertices: Float32Array, quads: IntArray) -> IntArray:
    """Split quads (Q, 4) along the shorter diagonal into triangles (2Q, 3)."""
    corner = vertices[quads]
    first = np.linalg.norm(corner[:, 0] - corner[:, 2], axis=1) <= np.linalg.norm(corner[:, 1] - corner[:, 3], axis=1)
    a = np.where(first[:, None], quads[:, [0, 1, 2]], quads[:, [0, 1, 3]])
    b = np.where(first[:, None], quads[:, [0, 2, 3]], quads[:, [1, 2, 3]])
    return np.concatenate([a, b]).astype(np.int64)


def _in_large_parts(quads: IntArray, vertex_count: int, fewest: int = 40) -> BoolArray:
    """Return True (Q,) for quads in connected parts of at least ``fewest``: others are noise."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    rows, columns = quads[:, [0, 1, 2]].ravel(), quads[:, [1, 2, 3]].ravel()
    graph = coo_matrix((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(vertex_count, vertex_count))
    _, label = connected_components(graph, directed=False)
    part = label[quads[:, 0]] if len(quads) else np.zeros(0, dtype=np.int64)
    large: BoolArray = np.bincount(part, minlength=1)[part] >= fewest
    return large


@kernel
def _count(  # noqa: C901
    count: AnyArray, origin: FloatArray, cell_m: float, position: FloatArray,
    points: Float32Array, normal: Float32Array, sigma_m: Float32Array, footprint_m: Float32Array,
) -> None:  # fmt: skip
    nx, ny, nz = count.shape
    along, across = np.zeros(3), np.zeros(3)
    for n in range(points.shape[0]):
        if sigma_m[n] > EVIDENCE_SIGMA_M:
            continue
        facing, reach = 0.0, 0.0
        for axis in range(3):
            facing += (points[n, axis] - position[axis]) * normal[n, axis]
            reach += (points[n, axis] - position[axis]) ** 2
        cosine = abs(facing) / np.sqrt(reach)
        steps_along, steps_across = 0, 0
        if cosine > 0.05:
            length = 0.0
            for axis in range(3):  # the line of sight projected onto the surface, and the direction across it
                along[axis] = points[n, axis] - position[axis] - facing * normal[n, axis]
                length += along[axis] ** 2
            length = np.sqrt(length) + 1e-9
            for axis in range(3):
                along[axis] *= cell_m / length
            for axis in range(3):
                first, second = (axis + 1) % 3, (axis + 2) % 3
                across[axis] = normal[n, first] * along[second] - normal[n, second] * along[first]
            half = 0.5 * footprint_m[n]
            steps_along, steps_across = int(min(half / cosine, FILL_M) / cell_m + 0.5), int(half / cell_m + 0.5)
        for s in range(-steps_along, steps_along + 1):
            for t in range(-steps_across, steps_across + 1):
                i = int(np.floor((points[n, 0] + s * along[0] + t * across[0] - origin[0]) / cell_m))
                j = int(np.floor((points[n, 1] + s * along[1] + t * across[1] - origin[1]) / cell_m))
                k = int(np.floor((points[n, 2] + s * along[2] + t * across[2] - origin[2]) / cell_m))
                if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
                    count[i, j, k] += 1


@kernel
def _spread(count: AnyArray, least: int, cells: BoolArray, out: BoolArray) -> None:  # noqa: C901
    """Dilate the cells with at least ``least`` points by one cell, along z, then y, then x."""
    nx, ny, nz = count.shape
    along_z, along_y = np.zeros((ny + 2, nz), dtype=np.bool_), np.zeros((3, ny, nz), dtype=np.bool_)
    for i in range(nx + 1):
        layer = along_y[i % 3]
        if i < nx:
            for j in range(ny):
                row, held = count[i, j], along_z[j + 1]
                for k in range(nz):
                    held[k] = row[k] >= least
                for k in range(1, nz - 1):
                    held[k] |= (row[k - 1] >= least) | (row[k + 1] >= least)
                if nz > 1:
                    held[0] |= row[1] >= least
                    held[nz - 1] |= row[nz - 2] >= least
            for j in range(ny):
                for k in range(nz):
                    layer[j, k] = along_z[j, k] | along_z[j + 1, k] | along_z[j + 2, k]
        else:
            layer[:] = False
        if i > 0:
            for j in range(ny):
                for k in range(nz):
                    out[i - 1, j, k] = (along_y[0, j, k] | along_y[1, j, k] | along_y[2, j, k]) & cells[i - 1, j, k]
