"""Size of a model against the truth.

Poses from the depth images have the scale of depth, and so has their model.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sitl.scene.scene import Scene

MODEL_POINTS = 60_000
TRUTH_POINTS = 300_000
# of the registration: largest distance of a pair, and iterations
STAGES = ((0.2, 60), (0.05, 60))

F64 = NDArray[np.float64]


def at_true_size(vertices_world: F64, scene: Scene) -> tuple[F64, float]:
    """Return the vertices (V, 3) at their best place and size, and the size that they had.

    That size is in true ones: 1.01 is 1 % too large. Point-to-point ICP with scale (open3d) onto the scene. Takes 5 s.
    """
    import open3d as o3d

    o3d.utility.random.seed(0)
    registration, points = o3d.pipelines.registration, o3d.utility.Vector3dVector
    mesh = o3d.geometry.TriangleMesh(points(scene.vertices.astype(np.float64)), o3d.utility.Vector3iVector(scene.faces.copy()))
    truth = mesh.sample_points_uniformly(TRUTH_POINTS)
    model = o3d.geometry.PointCloud(points(vertices_world[:: max(1, len(vertices_world) // MODEL_POINTS)].astype(np.float64)))
    truth_from_model, estimation = np.eye(4), registration.TransformationEstimationPointToPoint(with_scaling=True)
    for pair_m, iterations in STAGES:
        criteria = registration.ICPConvergenceCriteria(max_iteration=iterations)
        found = registration.registration_icp(model, truth, pair_m, truth_from_model, estimation, criteria)
        truth_from_model = np.array(found.transformation)
    turn_and_scale = truth_from_model[:3, :3]
    moved: F64 = vertices_world @ turn_and_scale.T + truth_from_model[:3, 3]
    return moved, 1.0 / float(np.cbrt(np.linalg.det(turn_and_scale)))
