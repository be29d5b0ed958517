"""Planner parameters of a room: the paper's table, or derived from fence box and camera."""

from __future__ import annotations

import math

import numpy as np

from uav_recon.config import PlannerConfig
from uav_recon.planning.camera_frustum import CameraGeometry
from uav_recon.types.frames import FloatArray

# the paper, table I; l_res, N_down, alpha and the thresholds given in its text are the same for all scenes
_ALL = {
    "view_spacing_m": 0.2,
    "end_factor": 3.0,
    "downsample": 5,
    "near_count": 3,
    "near_share": 0.2,
}
_KEYS = (
    "shell_min_m",
    "shell_max_m",
    "local_radius_m",
    "cluster_radius_m",
    "max_reconstruct_tasks",
    "min_visible",
    "near_distance_m",
    "horizon_m",
)
_TABLE: dict[str, tuple[float, ...]] = {
    "bhxhp": (1.0, 2.0, 2.5, 1.3, 15, 30, 2.0, 6.0),  # 65 m2
    "rosser": (0.8, 1.8, 2.0, 1.1, 10, 20, 1.5, 5.0),  # 40 m2
    "convoy": (0.5, 1.5, 1.5, 1.0, 10, 15, 1.0, 4.0),  # 20 m2
}
# side of a square with the area of the floor: the range of rooms for which the rules below were derived
SMALLEST_M = 4.2
LARGEST_M = 8.1


def derived(config: PlannerConfig, fence_min_m: FloatArray, fence_max_m: FloatArray, camera: CameraGeometry) -> PlannerConfig:
    """Fill in the values of the config's preset; keys written in the config file are kept.

    Applying it twice changes nothing.

    fence_min_m, fence_max_m: (3,) corners of the box to be explored.
    """
    if config.preset == "auto":
        values = _for_room(np.asarray(fence_max_m, dtype=np.float64) - np.asarray(fence_min_m, dtype=np.float64), camera)
    else:
        values = {**_ALL, **dict(zip(_KEYS, _TABLE[config.preset], strict=True))}
    return config.model_copy(update={key: value for key, value in values.items() if key not in config.model_fields_set})


def _for_room(size_m: FloatArray, camera: CameraGeometry) -> dict[str, float]:
    """Return lengths in metres and counts for a box of size (3,) in metres.

    The rules were tested in flights in rooms of 25 to 35 m2. The camera shows surface
    well up to its surface range, and the shorter side of its image limits the size of a cluster. The floor area gives the
    distance to the next task. A box larger than LARGEST_M is treated as a building, in which the radius of "near" does not
    grow.
    """
    side_m = float(np.clip(math.sqrt(size_m[0] * size_m[1]), SMALLEST_M, LARGEST_M))
    well_m = min(camera.surface_range_m, camera.range_m)
    half_picture = math.tan(min(camera.hfov_rad, camera.vfov_rad) / 2)
    # R_clu: a cluster fits into the image from two thirds of the surface range on
    cluster_m = half_picture * well_m * 2 / 3
    # d_f: the rim of the cluster is still well seen; with a fixed mount, ceilings and floors come into view here too
    far_m = well_m - cluster_m / 2
    # limit d_f so that a view does not require crossing the room
    far_m = max(min(far_m, float(max(size_m[0], size_m[1])) - 1.0), 1.0)
    # d_r: closer, the image shows less than 0.8 R_clu
    near_m = min(0.8 * cluster_m / (2 * half_picture), 0.8 * far_m)
    # R_loc: about a third of the side, so that from the middle it covers half of the room
    local_m = 0.36 * side_m
    return {
        "shell_min_m": _rounded(near_m),
        "shell_max_m": _rounded(far_m),
        "local_radius_m": _rounded(local_m),
        "cluster_radius_m": _rounded(cluster_m),
        # N_rec: the surface inside R_loc, taken as a sphere, is 4 (R_loc / R_clu)^2 discs of radius R_clu; a few overlap
        "max_reconstruct_tasks": int(np.clip(round(3 * (local_m / cluster_m) ** 2), 8, 15)),
        # N_min: the density of elements is constant, so a share of a cluster is a count proportional to its area
        "min_visible": int(np.clip(round(20 * (cluster_m / 1.1) ** 2), 10, 30)),
        # d_near and L_exec in the paper's proportion to R_loc
        "near_distance_m": _rounded(0.75 * local_m),
        "horizon_m": _rounded(2.5 * local_m),
        # alpha: large enough to reach from end to end of the box, at most the paper's value
        "end_factor": _rounded(float(np.clip(max(size_m[0], size_m[1]) / local_m, 1.0, 3.0))),
    }


def _rounded(metres: float) -> float:
    return round(metres, 2)
