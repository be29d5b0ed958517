"""A built-in building and a flight through it: two furnished rooms and a door.

It is used if no recorded stream is given. The depth image of a room of boxes is exact: each ray ends where it leaves the
room or enters the first box.
"""

from __future__ import annotations

import numpy as np

from uav_recon.bench.planner.recorded_stream import FAR_RANGES, RecordedStream, recorded
from uav_recon.geometry.jit import kernel
from uav_recon.types.camera import BODY_FROM_OPTICAL, Intrinsics
from uav_recon.types.frames import Float32Array, FloatArray
from uav_recon.types.pose import Pose

LOW_M = np.array([-5.0, -3.0, 0.0])
HIGH_M = np.array([5.0, 3.0, 3.0])
MAX_RANGE_M = 4.5
STEP_M = 0.15  # between two images
LENS = Intrinsics.from_fov(320, 240, np.radians(87.0), np.radians(71.0))
_BOXES = np.array(
    [  # x0, y0, z0, x1, y1, z1: the wall with its door, then furniture
        [-0.1, -3.0, 0.0, 0.1, -0.7, 3.0],
        [-0.1, 0.5, 0.0, 0.1, 3.0, 3.0],
        [-0.1, -0.7, 2.1, 0.1, 0.5, 3.0],
        [-3.3, -0.4, 0.65, -1.9, 0.4, 0.75],
        [-2.7, -0.1, 0.0, -2.5, 0.1, 0.65],
        [-5.0, 1.2, 0.0, -4.2, 2.8, 0.5],
        [-4.0, -3.0, 0.0, -2.8, -2.4, 2.0],
        [-1.2, 2.5, 0.0, -0.4, 3.0, 1.8],
        [2.6, 1.3, 0.0, 4.6, 2.9, 0.5],
        [1.6, -0.4, 0.0, 2.0, 0.0, 3.0],
        [2.2, -3.0, 0.7, 4.0, -2.3, 0.8],
        [4.4, -2.0, 0.0, 5.0, -0.8, 1.0],
    ]
)
_WAY_M = np.array(
    [
        [-4.2, -1.8, 1.2],
        [-3.7, 0.9, 1.3],
        [-2.6, 1.6, 1.4],
        [-1.1, 1.2, 1.3],
        [-1.1, -1.5, 1.3],
        [-0.6, -0.1, 1.2],
        [0.7, -0.1, 1.2],
        [1.3, -1.2, 1.3],
        [3.2, -1.2, 1.4],
        [3.6, 0.1, 1.4],
        [1.3, 1.3, 1.4],
    ]
)


def fly_through() -> RecordedStream:
    """Render all images of the flight. Takes about a second.

    The camera cosine_sums up to 15° down, and left and right of the path.
    """
    legs_m = np.linalg.norm(np.diff(_WAY_M, axis=0), axis=1)
    along_m = np.concatenate(([0.0], np.cumsum(legs_m)))
    at_m = np.arange(0.0, along_m[-1], STEP_M)
    place_m = np.column_stack([np.interp(at_m, along_m, _WAY_M[:, axis]) for axis in range(3)])
    leg = np.clip(np.searchsorted(along_m, at_m, side="right") - 1, 0, len(legs_m) - 1)
    way_m = np.diff(_WAY_M, axis=0)[leg]
    yaw_rad = np.arctan2(way_m[:, 1], way_m[:, 0]) + np.radians(70.0) * np.sin(at_m * 1.1)
    pitch_rad = np.radians(7.5) * (1.0 - np.cos(at_m * 0.7))
    frames = []
    for n in range(len(at_m)):
        tilt = Pose.from_rotation_vector(np.array([0.0, pitch_rad[n], 0.0]), np.zeros(3))
        pose = Pose.from_yaw(float(yaw_rad[n]), place_m[n]) @ tilt @ Pose.from_matrix(BODY_FROM_OPTICAL)
        frames.append(recorded(_picture(pose), pose, LENS, n))
    return RecordedStream("built-in building", tuple(frames), LENS, LOW_M, HIGH_M, MAX_RANGE_M)


def _picture(pose: Pose) -> Float32Array:
    rays = np.ascontiguousarray(LENS.bearings() @ pose.rotation().T)
    return _depth(rays, pose.translation_m, LOW_M, HIGH_M, _BOXES, MAX_RANGE_M, FAR_RANGES * MAX_RANGE_M)


@kernel
def _depth(
    rays: FloatArray, eye: FloatArray, low: FloatArray, high: FloatArray, boxes: FloatArray, range_m: float, far_m: float
) -> Float32Array:
    """Compute a depth image by the slab method.

    rays: (H, W, 3), of length 1 along the optical axis, so that the line parameter is the depth.
    """
    height, width, _ = rays.shape
    out = np.empty((height, width), dtype=np.float32)
    for v in range(height):
        for u in range(width):
            nearest, length2 = np.inf, 0.0
            for axis in range(3):
                d = rays[v, u, axis] if abs(rays[v, u, axis]) > 1e-12 else 1e-12
                length2 += d * d
                wall = high[axis] if d > 0 else low[axis]
                nearest = min(nearest, (wall - eye[axis]) / d)
            for n in range(len(boxes)):
                enter, leave = 0.0, nearest
                for axis in range(3):
                    d = rays[v, u, axis] if abs(rays[v, u, axis]) > 1e-12 else 1e-12
                    a, b = (boxes[n, axis] - eye[axis]) / d, (boxes[n, axis + 3] - eye[axis]) / d
                    enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
                if enter < leave and enter > 0.0:
                    nearest = enter
            out[v, u] = nearest if nearest * np.sqrt(length2) <= range_m else far_m
    return out
