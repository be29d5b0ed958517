"""The same surface in as few triangles as it needs, for a camera that sees no colour.

A scanned room is painted vertex by vertex: its walls are thousands of triangles in one plane. Where colour does not matter
those are one polygon. Quadric error metrics (Garland and Heckbert 1997) collapse edges as long as the squared distance from
the planes of what was there stays below a hair.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sitl.runtime.array_cache import Arrays, cache_folder, cached, key

WORTH_FACES = 50_000  # below it drawing is quick as it is
MAX_ERROR_M2 = 1e-12  # a thousandth of a millimetre, squared, and times the area that the quadrics weigh with
TOLERANCE_M, TOLERATED = 0.001, 1e-5  # the camera tells millimetres; this share of points may be farther off, or all is left
LOST_M = 0.0004  # a triangle that far from the other surface is taken out, or put back as it was
ROUNDS, SAMPLES = 3, 200_000
VERSION = 1
F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
LOG = logging.getLogger(__name__)


def merged(vertices: F32, faces: I32, cache_dir: Path | None = None) -> tuple[F32, I32]:
    """Vertices (V, 3) and faces (F, 3) of the same surface, within TOLERANCE_M both ways; or what was given, if that failed.

    Blocks for up to a minute the first time, then it is kept in the cache.
    """
    if len(faces) < WORTH_FACES:
        return vertices, faces
    path = (cache_dir or cache_folder()) / f"merged-{key(vertices, faces, f'{VERSION} {MAX_ERROR_M2} {TOLERANCE_M}')}.npz"
    arrays = cached(path, {"vertices": 2, "faces": 2}, lambda: _collapsed(vertices, faces))
    return arrays["vertices"], arrays["faces"]


def _collapsed(vertices: F32, faces: I32) -> Arrays:
    import open3d

    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(vertices.astype(np.float64)), open3d.utility.Vector3iVector(np.array(faces, np.int32))
    )
    fewer = mesh.simplify_quadric_decimation(4, maximum_error=MAX_ERROR_M2)
    corners, triangles = np.asarray(fewer.vertices, np.float32), np.asarray(fewer.triangles, np.int32)
    good, lost = np.ones(len(triangles), np.bool_), np.zeros(len(faces), np.bool_)
    for seed in range(ROUNDS):  # small things weigh nothing in quadrics, so there the surface is left as it was
        points, owner = _points(corners, triangles, seed)
        good[owner[_distance_m(points, vertices, faces) > LOST_M]] = False
    triangles = triangles[good]
    for seed in range(ROUNDS):
        points, owner = _points(vertices, faces, seed)
        lost[owner[_distance_m(points, corners, triangles) > LOST_M]] = True
    triangles = np.concatenate([triangles, faces[lost] + np.int32(len(corners))])
    corners = np.concatenate([corners, vertices])
    used, number = np.unique(triangles, return_inverse=True)
    corners, triangles = corners[used], number.reshape(-1, 3).astype(np.int32)
    there, back = _points(vertices, faces, ROUNDS)[0], _points(corners, triangles, ROUNDS)[0]
    off_m = np.concatenate([_distance_m(there, corners, triangles), _distance_m(back, vertices, faces)])
    if (off_m > TOLERANCE_M).mean() > TOLERATED:
        LOG.warning("%d triangles are drawn as they are: merged, they would be off by up to %.2g m", len(faces), off_m.max())
        return {"vertices": vertices, "faces": faces}
    return {"vertices": corners, "faces": triangles}


def _points(vertices: F32, faces: I32, seed: int) -> tuple[F32, NDArray[np.int64]]:
    """Corners, centre, edges' middles and a random point of every face, and SAMPLES random points of the whole surface:
    (N, 3), and whose they are (N,).
    """  # fmt: skip
    rng, every = np.random.default_rng(seed), np.arange(len(faces))
    corner = vertices[faces]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    shares = [np.eye(3), np.full((1, 3), 1 / 3), (1 - np.eye(3)) / 2]
    fixed = np.concatenate(shares).astype(np.float32)
    owner = np.concatenate([every, rng.choice(len(faces), SAMPLES, p=area / area.sum())])
    share = rng.dirichlet(np.ones(3), len(owner)).astype(np.float32)
    points = [np.einsum("sk,fkx->fsx", fixed, corner).reshape(-1, 3), np.einsum("nk,nkx->nx", share, corner[owner])]
    return np.concatenate(points), np.concatenate([np.repeat(every, len(fixed)), owner])


def _distance_m(points: F32, vertices: F32, faces: I32) -> F32:
    """How far points (N, 3) are from a surface (N,)."""
    import open3d

    tensor = open3d.core.Tensor.from_numpy
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(tensor(np.array(vertices)), tensor(faces.astype(np.uint32)))
    distance: F32 = scene.compute_distance(tensor(points)).numpy()
    return distance
