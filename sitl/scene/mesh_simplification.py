"""Simplification of a mesh without change of its surface, for cameras that need no colour.

A scanned room has a colour per vertex, so its walls are thousands of triangles in one plane. Without colour these can be
merged. Edges are collapsed by quadric error metrics (Garland and Heckbert 1997) while the squared distance to the planes
of the original triangles stays below MAX_ERROR_M2.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sitl.runtime.array_cache import Arrays, cache_folder, cached, key

WORTH_FACES = 50_000  # smaller meshes are rendered fast enough
MAX_ERROR_M2 = 1e-12  # (1 µm)², times the area with which Open3D weights the quadrics
TOLERANCE_M = 0.001  # camera resolution
MAX_OUTLIER_SHARE = 1e-5  # share of points that may be farther off than that
MAX_FACE_ERROR_M = 0.0004  # merged triangles farther than this from the original are removed, originals that far off restored
ROUNDS = 3
SAMPLES = 200_000
VERSION = 1
F32 = NDArray[np.float32]
I32 = NDArray[np.int32]
LOG = logging.getLogger(__name__)


def simplified(vertices: F32, faces: I32, cache_dir: Path | None = None) -> tuple[F32, I32]:
    """Return vertices (V, 3) and faces (F, 3) of a simplified mesh of the same surface.

    Both surfaces agree within TOLERANCE_M in both directions; if that fails, the original mesh is returned. Blocks for up
    to a minute the first time; the result is cached.
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
    for seed in range(ROUNDS):  # small objects have little quadric weight and may vanish: keep their original triangles
        points, owner = _points(corners, triangles, seed)
        good[owner[_distance_m(points, vertices, faces) > MAX_FACE_ERROR_M]] = False
    triangles = triangles[good]
    for seed in range(ROUNDS):
        points, owner = _points(vertices, faces, seed)
        lost[owner[_distance_m(points, corners, triangles) > MAX_FACE_ERROR_M]] = True
    triangles = np.concatenate([triangles, faces[lost] + np.int32(len(corners))])
    corners = np.concatenate([corners, vertices])
    used, number = np.unique(triangles, return_inverse=True)
    corners, triangles = corners[used], number.reshape(-1, 3).astype(np.int32)
    there, back = _points(vertices, faces, ROUNDS)[0], _points(corners, triangles, ROUNDS)[0]
    off_m = np.concatenate([_distance_m(there, corners, triangles), _distance_m(back, vertices, faces)])
    if (off_m > TOLERANCE_M).mean() > MAX_OUTLIER_SHARE:
        LOG.warning("%d triangles are rendered without simplification: error up to %.2g m", len(faces), off_m.max())
        return {"vertices": vertices, "faces": faces}
    return {"vertices": corners, "faces": triangles}


def _points(vertices: F32, faces: I32, seed: int) -> tuple[F32, NDArray[np.int64]]:
    """Return sample points (N, 3) of a mesh and the index (N,) of the face of each.

    They are the centre, corners and edge midpoints of every face, one random point per face, and SAMPLES random points of
    the whole surface.
    """
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
    """Return the distance (N,), m, of points (N, 3) from a surface."""
    import open3d

    tensor = open3d.core.Tensor.from_numpy
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(tensor(np.array(vertices)), tensor(faces.astype(np.uint32)))
    distance: F32 = scene.compute_distance(tensor(points)).numpy()
    return distance
