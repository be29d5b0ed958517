"""Small recorded stream on disk: a camera turns around in a box room of 2 x 2 x 2 m."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from uav_recon.types.camera import BODY_FROM_OPTICAL, Intrinsics
from uav_recon.types.pose import Pose

LENS = Intrinsics(fx=20.0, fy=20.0, cx=15.5, cy=11.5, width=32, height=24)
SIZE = "32x24"


def write_stream(folder: Path, frames: int = 6) -> Path:
    """Write meta.json, poses.npy and depth_32x24.npz; the last row of each image has no return."""
    folder.mkdir()
    room = [[-1.0, -1.0, 0.0], [1.0, 1.0, 2.0]]
    focal = {"fx": LENS.fx, "fy": LENS.fy, "cx": LENS.cx, "cy": LENS.cy}
    (folder / "meta.json").write_text(json.dumps({"room": room, "max_range_m": 3.0, SIZE: focal}))
    poses, images = [], []
    for n in range(frames):
        pose = Pose.from_yaw(n * 2 * np.pi / frames, np.array([0.0, 0.0, 1.0])) @ Pose.from_matrix(BODY_FROM_OPTICAL)
        rays = LENS.bearings() @ pose.rotation().T
        with np.errstate(divide="ignore"):
            walls = np.maximum((np.array(room[0]) - pose.translation_m) / rays, (np.array(room[1]) - pose.translation_m) / rays)
        depth_mm = np.round(walls.min(axis=-1) * 1e3).astype(np.uint16)
        depth_mm[-1] = 0
        poses.append(pose.matrix())
        images.append(depth_mm)
    np.save(folder / "poses.npy", np.array(poses))
    np.savez(folder / f"depth_{SIZE}.npz", depth_mm=np.array(images))
    return folder
