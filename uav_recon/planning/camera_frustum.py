"""The camera model of the planner: a frustum on the body, with kernel parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.geometry.view_information import Eye
from uav_recon.types.frames import FloatArray, frozen
from uav_recon.types.rgbd_camera import Camera

EDGE_MARGIN = 0.95  # of the half-frustum's tangent: what a small error of pose would push out of the picture is not promised
RANGE_SHARE = 0.9  # of the map's range: to which an unknown voxel is expected to be decided
# order of the numbers in CameraGeometry.lens()
TAN_H, TAN_V, NEAR, RANGE, CAM_X, CAM_Y, CAM_Z, PITCH_MIN, PITCH_MAX, COS_MIN, SIN_MIN, COS_MAX, SIN_MAX = range(13)

LineOfSight = tuple[float, float, float, float, float, float, float]  # eye x, y, z, cos and sin of yaw, cos and sin of pitch


@dataclass(frozen=True, slots=True, eq=False)
class CameraGeometry:
    """A depth camera on the body.

    hfov_rad, vfov_rad: full angles of view.
    position_body_m: (3,) position of the imager.
    pitch_min_rad, pitch_max_rad: range of the pitch, positive cosine_sums DOWN. A fixed mount has its tilt as both.
    range_m: range up to which an unknown voxel is expected to become known.
    surface_range_m: range up to which a surface counts as well seen.
    near_m: returns closer than this are ignored.
    """

    hfov_rad: float
    vfov_rad: float
    position_body_m: FloatArray
    pitch_min_rad: float
    pitch_max_rad: float
    range_m: float
    surface_range_m: float = 3.0
    near_m: float = 0.3

    def __post_init__(self) -> None:
        object.__setattr__(self, "position_body_m", frozen(np.asarray(self.position_body_m, dtype=np.float64)))
        if self.pitch_max_rad < self.pitch_min_rad:
            raise ValueError(f"camera pitch range is empty: {self.pitch_min_rad} to {self.pitch_max_rad} rad")

    @staticmethod
    def of(camera: Camera, max_range_m: float) -> CameraGeometry:
        """Return the geometry of a camera on its fixed mount.

        max_range_m: range of the occupancy map (m).
        """
        lens = camera.depth
        return CameraGeometry(
            hfov_rad=2.0 * math.atan(0.5 * lens.width / lens.fx),
            vfov_rad=2.0 * math.atan(0.5 * lens.height / lens.fy),
            position_body_m=camera.position_body_m,
            pitch_min_rad=camera.pitch_down_rad,
            pitch_max_rad=camera.pitch_down_rad,
            range_m=max_range_m * RANGE_SHARE,
            near_m=camera.depth_min_m,
        )

    @property
    def eye(self) -> Eye:
        """The camera as view_sigmas() takes it."""
        x, y, z = self.position_body_m.tolist()
        return Eye((math.tan(self.hfov_rad / 2.0), math.tan(self.vfov_rad / 2.0)), (x, y, z))

    def lens(self, resolution_m: float, range_m: float) -> FloatArray:
        """Pack the parameters for a kernel, lengths in voxels: (13,) in the order TAN_H ... SIN_MAX."""
        position = self.position_body_m / resolution_m
        return np.array(
            [
                np.tan(self.hfov_rad / 2) * EDGE_MARGIN,
                np.tan(self.vfov_rad / 2) * EDGE_MARGIN,
                self.near_m / resolution_m,
                range_m / resolution_m,
                position[0],
                position[1],
                position[2],
                self.pitch_min_rad,
                self.pitch_max_rad,
                np.cos(self.pitch_min_rad),
                np.sin(self.pitch_min_rad),
                np.cos(self.pitch_max_rad),
                np.sin(self.pitch_max_rad),
            ]
        )


@kernel
def aim(lens: FloatArray, x: float, y: float, z: float, tx: float, ty: float, tz: float) -> tuple[float, float]:
    """Return yaw and pitch (down) with which a body at (x, y, z) looks at a target (tx, ty, tz).

    Positions are in voxels. The pitch is limited to the range of the mount.
    """
    dx, dy = tx - x, ty - y
    yaw = np.arctan2(dy, dx)
    flat = max(np.sqrt(dx * dx + dy * dy) - lens[CAM_X], 1e-6)
    pitch = np.arctan2(z + lens[CAM_Z] - tz, flat)
    return yaw, min(max(pitch, lens[PITCH_MIN]), lens[PITCH_MAX])


@kernel
def sight(lens: FloatArray, place: FloatArray, yaw_rad: float, pitch_down_rad: float) -> LineOfSight:
    """Return the line of sight of a level body at ``place`` (3,), in voxels.

    The line of sight holds the camera position and the cosines and sines of yaw and pitch.
    """
    cy, sy = np.cos(yaw_rad), np.sin(yaw_rad)
    x = place[0] + cy * lens[CAM_X] - sy * lens[CAM_Y]
    y = place[1] + sy * lens[CAM_X] + cy * lens[CAM_Y]
    return x, y, place[2] + lens[CAM_Z], cy, sy, np.cos(pitch_down_rad), np.sin(pitch_down_rad)


@kernel
def look_at(lens: FloatArray, x: float, y: float, z: float, tx: float, ty: float, tz: float) -> LineOfSight:
    """Return sight() of a body at (x, y, z) with the angles of aim(), without trigonometry."""
    dx, dy = tx - x, ty - y
    across = np.sqrt(dx * dx + dy * dy)
    cy, sy = (dx / across, dy / across) if across > 1e-9 else (1.0, 0.0)
    flat, down = max(across - lens[CAM_X], 1e-6), z + lens[CAM_Z] - tz
    length = np.sqrt(flat * flat + down * down)
    cp, sp = flat / length, down / length
    if sp < lens[SIN_MIN]:
        cp, sp = lens[COS_MIN], lens[SIN_MIN]
    elif sp > lens[SIN_MAX]:
        cp, sp = lens[COS_MAX], lens[SIN_MAX]
    eye_x, eye_y = x + cy * lens[CAM_X] - sy * lens[CAM_Y], y + sy * lens[CAM_X] + cy * lens[CAM_Y]
    return eye_x, eye_y, z + lens[CAM_Z], cy, sy, cp, sp


@kernel
def in_view(lens: FloatArray, sight: LineOfSight, x: float, y: float, z: float) -> bool:
    """Return True if a point (voxels) is in front of the camera, in its frustum and in range."""
    eye_x, eye_y, eye_z, cy, sy, cp, sp = sight
    dx, dy, dz = x - eye_x, y - eye_y, z - eye_z
    distance2 = dx * dx + dy * dy + dz * dz
    if distance2 > lens[RANGE] * lens[RANGE] or distance2 < lens[NEAR] * lens[NEAR]:
        return False
    along = cy * dx + sy * dy
    forward = cp * along - sp * dz
    left = -sy * dx + cy * dy
    up = sp * along + cp * dz
    return bool(forward > 0.0 and abs(left) <= forward * lens[TAN_H] and abs(up) <= forward * lens[TAN_V])
