"""Small simulator for planner tests: box rooms, a perfect depth camera, an occupancy map.

Rays are sampled instead of traversed, so that an error in the planner's own traversal cannot go unnoticed here.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from uav_recon.planning.camera_frustum import CameraGeometry
from uav_recon.types.maps import FREE, OCCUPIED, GridSpec, VoxelMap
from uav_recon.types.tasks import PlanRequest, ViewPath

RESOLUTION_M = 0.1
TILT_RAD = np.radians(15.0)
FIXED = CameraGeometry(np.radians(87), np.radians(58), np.array([0.1, 0.0, 0.0]), TILT_RAD, TILT_RAD, 4.5)
GIMBAL = CameraGeometry(np.radians(87), np.radians(58), np.array([0.1, 0.0, 0.0]), -np.radians(60), np.radians(60), 4.5)

Solid = NDArray[np.bool_]


def room(size_m: tuple[float, float, float], boxes: list[tuple[float, ...]]) -> Solid:
    """Return the solid voxels (nx, ny, nz) of a closed room with boxes (x0, y0, z0, x1, y1, z1).

    The wall is one voxel thick on all sides.
    """
    shape = tuple(round(s / RESOLUTION_M) + 2 for s in size_m)
    solid = np.ones(shape, dtype=np.bool_)
    solid[1:-1, 1:-1, 1:-1] = False
    for box in boxes:
        low, high = (np.round(np.array(corner) / RESOLUTION_M).astype(int) + 1 for corner in (box[:3], box[3:]))
        solid[low[0] : high[0], low[1] : high[1], low[2] : high[2]] = True
    return solid


MEETING_ROOM = room((6.2, 5.0, 2.4), [(2, 1.8, 0.6, 4.2, 3.0, 0.8), (0, 4.4, 0, 1.2, 5.0, 1.8), (5.6, 0, 0, 6.2, 1.6, 1.2)])
TWO_ROOMS = room((8.0, 4.0, 2.5), [(3.9, 0, 0, 4.0, 1.4, 2.5), (3.9, 2.6, 0, 4.0, 4.0, 2.5), (6.0, 1.0, 0, 7.0, 2.0, 0.8)])


def grid_of(solid: Solid) -> GridSpec:
    """Return the grid of a room; the inner lower corner of the room is the world's origin."""
    nx, ny, nz = solid.shape
    return GridSpec(np.full(3, -RESOLUTION_M), RESOLUTION_M, (nx, ny, nz))


def voxel_map(state: NDArray[np.uint8], revision: int = 0, epoch: int = 0) -> VoxelMap:
    """Return a map with its distance field."""
    nx, ny, nz = state.shape
    distance = ndimage.distance_transform_edt(np.pad(state == FREE, 1))[1:-1, 1:-1, 1:-1]
    grid = GridSpec(np.full(3, -RESOLUTION_M), RESOLUTION_M, (nx, ny, nz))
    return VoxelMap.whole(grid, state, np.round(np.minimum(distance, 11.0) ** 2).astype(np.uint8), revision, epoch)


@numba.njit(cache=True)
def _look(solid, state, eye, yaw, pitch, tan_h, tan_v, reach):  # type: ignore[no-untyped-def]
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    for v in range(-24, 25):
        for u in range(-36, 37):
            left, up = tan_h * u / 36.0, tan_v * v / 24.0
            flat = cp + sp * up
            x, y, z = cy * flat - sy * left, sy * flat + cy * left, -sp + cp * up
            length = np.sqrt(x * x + y * y + z * z)
            x, y, z = x / length, y / length, z / length  # numbers, because an array at each step is slow
            for step in range(int(reach * 6)):
                far = step / 6.0
                i, j, k = int(eye[0] + x * far), int(eye[1] + y * far), int(eye[2] + z * far)
                if solid[i, j, k]:
                    state[i, j, k] = OCCUPIED
                    break
                state[i, j, k] = FREE


@dataclass
class BoxWorld:
    """Vehicle that flies every path it is given and maps on the way.

    length_m, views and track record what it did.
    """

    solid: Solid
    camera: CameraGeometry
    position: NDArray[np.float64]
    yaw_rad: float = 0.0
    length_m: float = 0.0
    views: int = 0
    revision: int = 0
    track: list[NDArray[np.float64]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.state = np.zeros(self.solid.shape, dtype=np.uint8)
        cell = np.floor(self.position / RESOLUTION_M).astype(int) + 1
        around = tuple(slice(max(c - 6, 0), c + 7) for c in cell)
        self.state[around] = np.where(self.solid[around], 0, FREE)  # declared free by the operator
        self.track.append(self.position)

    def look(self, pitch_rad: float) -> None:
        look_from(self.solid, self.state, self.camera, self.position, self.yaw_rad, pitch_rad)
        self.revision += 1

    def look_round(self) -> None:
        for n in range(8):
            self.yaw_rad = n * np.pi / 4
            self.look(float(np.clip(0.0, self.camera.pitch_min_rad, self.camera.pitch_max_rad)))

    def fly(self, path: ViewPath) -> None:
        """Fly along every segment with an even turn; map every 0.3 m and at each view."""
        for view, way in zip(path.viewpoints, path.waypoints_world, strict=True):
            lengths = np.linalg.norm(np.diff(way, axis=0), axis=1)
            total = float(lengths.sum())
            along = np.concatenate(([0.0], np.cumsum(lengths)))
            turn = (view.yaw_rad - self.yaw_rad + np.pi) % (2 * np.pi) - np.pi
            start_yaw = self.yaw_rad
            for at in np.arange(0.3, total, 0.3):
                self.position = np.array([np.interp(at, along, way[:, axis]) for axis in range(3)])
                self.yaw_rad = start_yaw + turn * at / total
                self.look(view.pitch_down_rad)
            self.position = np.array(view.position_world)
            self.yaw_rad = view.yaw_rad
            self.length_m += total
            self.views += 1
            self.track.extend(way[1:])
            self.look(view.pitch_down_rad)

    def request(self, views_left: int = 200) -> PlanRequest:
        return PlanRequest(voxel_map(self.state.copy(), self.revision), None, self.position, self.yaw_rad, views_left)


def look_from(
    solid: Solid,
    state: NDArray[np.uint8],
    camera: CameraGeometry,
    position: NDArray[np.float64],
    yaw_rad: float,
    pitch_rad: float,
) -> None:
    """Fill ``state`` with what a camera on a body at this pose sees."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    mount = camera.position_body_m
    eye = position + np.array([c * mount[0] - s * mount[1], s * mount[0] + c * mount[1], mount[2]])
    tan_h, tan_v = np.tan(camera.hfov_rad / 2), np.tan(camera.vfov_rad / 2)
    _look(solid, state, eye / RESOLUTION_M + 1.0, yaw_rad, pitch_rad, tan_h, tan_v, camera.range_m / RESOLUTION_M)


def visible_from_anywhere(
    solid: Solid, camera: CameraGeometry, start: NDArray[np.float64], poses: int = 250
) -> NDArray[np.bool_]:
    """Return the free voxels that the camera sees from any pose that the vehicle can reach.

    This is the space that can be explored at all.
    """
    distance = ndimage.distance_transform_edt(~solid) * RESOLUTION_M
    labels, _ = ndimage.label(distance >= 0.4, structure=np.ones((3, 3, 3)))
    home = labels[tuple(np.floor(start / RESOLUTION_M).astype(int) + 1)]
    reachable = np.argwhere(labels == home)
    rng = np.random.default_rng(7)
    state = np.zeros(solid.shape, dtype=np.uint8)
    for cell in reachable[rng.integers(len(reachable), size=poses)]:
        pitch = rng.uniform(camera.pitch_min_rad, camera.pitch_max_rad)
        look_from(solid, state, camera, (cell - 0.5) * RESOLUTION_M, rng.uniform(-np.pi, np.pi), pitch)
    return np.asarray(state == FREE)
