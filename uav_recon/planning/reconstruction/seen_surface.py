"""Surface that keyframes show in passing (not in the paper).

The views of tasks are the few that were asked for. Most keyframes are taken on the way or while exploring, and what they show
needs no task of its own.
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.planning.camera_frustum import CameraGeometry, LineOfSight
from uav_recon.planning.reconstruction.surface_elements import ElementsCache, max_cosine_per_voxel
from uav_recon.planning.reconstruction.view_gain import visible_gain
from uav_recon.types.frames import Float32Array
from uav_recon.types.maps import GridSpec
from uav_recon.types.pose import Pose
from uav_recon.types.tasks import PlanRequest

PASSING_SHARE = 0.5  # of the cosine under which a keyframe shows surface: it is not aimed at it, as the view of a task is


class SeenSurface:
    """Counts the keyframes of one flight, each once the surface is newer than it.

    elements: cache of the surface, shared with the tasks.
    """

    def __init__(self, camera: CameraGeometry, elements: ElementsCache) -> None:
        self._camera = camera
        self._elements = elements
        self._counted = 0
        self._due = 0  # number of keyframes that there were with the last surface
        self._revision = -1  # of that
        self._map_epoch = -1

    def update(self, request: PlanRequest, cosine_sums: Float32Array) -> None:
        """Add the keyframes of a request to cosine_sums (nx, ny, nz); see ViewHistory."""
        voxels, surface, keyframes = request.voxels, request.surface, request.keyframes
        if voxels.map_epoch != self._map_epoch or len(keyframes) < self._counted:
            self._map_epoch, self._counted, self._due, self._revision = voxels.map_epoch, 0, 0, -1
        if surface is None or surface.revision == self._revision:
            return
        due, self._due, self._revision = self._due, len(keyframes), surface.revision
        elements = self._elements.of(surface, voxels.grid)
        lens = self._camera.lens(voxels.grid.resolution_m, min(self._camera.surface_range_m, self._camera.range_m))
        cosine, sums = np.zeros(len(elements.voxel)), cosine_sums.reshape(-1)
        weight = np.ones(len(elements.voxel))
        for pose in keyframes[self._counted : due]:
            eye = _line_of_sight(pose, voxels.grid)
            visible_gain(
                voxels.state, lens, eye, elements.position, elements.normal, weight, elements.cells, True, cosine
            )  # fmt: skip
            seen = np.flatnonzero(cosine)
            voxel, best = max_cosine_per_voxel(elements.voxel[seen], cosine[seen])
            sums[voxel] += (PASSING_SHARE * best).astype(np.float32)
        self._counted = max(due, self._counted)


def _line_of_sight(world_from_depth: Pose, grid: GridSpec) -> LineOfSight:
    """Return the line of sight of a depth imager, without its roll."""
    x, y, z = ((world_from_depth.translation_m - grid.origin_world_m) / grid.resolution_m).tolist()
    ahead = world_from_depth.rotation()[:, 2]
    flat = max(math.hypot(ahead[0], ahead[1]), 1e-9)
    return x, y, z, float(ahead[0] / flat), float(ahead[1] / flat), flat, float(-ahead[2])
