"""Writers of tiny recordings, independent of the readers: numpy, OpenCV and text."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from uav_recon.sensors.stream_format import CameraSpec, StreamHeader
from uav_recon.types.camera import body_from_camera
from uav_recon.types.pose import Pose

SHAPE = (48, 64)
K = (60.0, 61.0, 31.0, 23.0)
RGB_FROM_DEPTH = Pose(np.array([0.999, 0.01, -0.02, 0.03]), np.array([0.015, 0.001, 0.0]))
MOUNT = body_from_camera(np.array([0.1, 0.02, -0.03]), 0.26)
HEADER = StreamHeader(
    CameraSpec(SHAPE[1], SHAPE[0], *K), CameraSpec(80, 60, 70.0, 71.0, 39.0, 29.0),
    (*RGB_FROM_DEPTH.quat_wxyz.tolist(), *RGB_FROM_DEPTH.translation_m.tolist()),
)  # fmt: skip


def depth_mm(number: int) -> np.ndarray:
    rows, columns = np.indices(SHAPE)
    image = (1000 + 10 * rows + columns + number).astype(np.uint16)
    image[0, 0], image[0, 1] = 0, 65535
    return image


def rgb(number: int) -> np.ndarray:
    image = np.zeros((*SHAPE, 3), np.uint8)
    image[...] = (200, 100, 10 * (number % 20))
    return image


def large_rgb(number: int) -> np.ndarray:
    return np.asarray(cv2.resize(rgb(number), (80, 60)))


def world_from_optical(number: int) -> np.ndarray:
    angle = 0.05 * number
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    pose[:3, 3] = (0.1 * number, 0.2, 0.3)
    return pose


def write_seven_scenes(folder: Path, frames: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    fx, fy, cx, cy = K
    np.savetxt(folder / "camera-intrinsics.txt", np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]))
    for number in range(frames):
        cv2.imwrite(str(folder / f"frame-{number:06d}.depth.png"), depth_mm(number))
        cv2.imwrite(str(folder / f"frame-{number:06d}.color.png"), rgb(number)[..., ::-1])
        np.savetxt(folder / f"frame-{number:06d}.pose.txt", world_from_optical(number))


def write_tum(folder: Path, frames: int, poses: bool = True) -> None:
    (folder / "depth").mkdir(parents=True)
    (folder / "rgb").mkdir()
    lists: dict[str, list[str]] = {"depth": ["# depth maps"], "rgb": ["# colour images"], "groundtruth": ["# stamp tx .. qw"]}
    for number in range(frames):
        stamp_s = 100.0 + number / 30.0
        cv2.imwrite(str(folder / f"depth/{stamp_s:.6f}.png"), depth_mm(number) * np.uint16(5))
        cv2.imwrite(str(folder / f"rgb/{stamp_s + 0.011:.6f}.png"), rgb(number)[..., ::-1])
        lists["depth"].append(f"{stamp_s:.6f} depth/{stamp_s:.6f}.png")
        lists["rgb"].append(f"{stamp_s + 0.011:.6f} rgb/{stamp_s + 0.011:.6f}.png")
        half, t = 0.025 * number, world_from_optical(number)[:3, 3]
        lists["groundtruth"].append(f"{stamp_s:.6f} {t[0]} {t[1]} {t[2]} 0 0 {np.sin(half)} {np.cos(half)}")
    if not poses:
        del lists["groundtruth"]
    for name, lines in lists.items():
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
