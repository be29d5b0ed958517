"""DROID-SLAM of a checkout on PYTHONPATH, with weights by path.

Not tried with the real engine. It needs an NVIDIA GPU and compiled extensions. Poses are those of its keyframes, late: they
suit a recording or a motion by hand, and no flight.
"""

from __future__ import annotations

import importlib
import zipfile
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np

from uav_recon.trackers.engine import RgbdView, TrackedPose, TrackerError
from uav_recon.types.camera import Intrinsics
from uav_recon.types.pose import Pose

_PIXELS = 384 * 512  # of the images that the network was trained on
_CELL_PX = 8  # image sizes are whole multiples
_BUFFER = 512
_LAG = 2  # newest keyframes, which are still optimised
_ENCODER = (("conv1", (32, 3, 7, 7)), ("layer1.0.conv1", (32, 32, 3, 3)), ("layer2.0.downsample.0", (64, 32, 1, 1)),
            ("layer3.1.conv2", (128, 128, 3, 3)))  # fmt: skip
# parts of the network by name, with their shapes; the checkpoint may hold them below "module."
SHAPES: dict[str, tuple[int, ...]] = {
    **{f"{net}.{name}.weight": shape for net in ("fnet", "cnet") for name, shape in _ENCODER},
    "fnet.conv2.weight": (128, 128, 1, 1),
    "cnet.conv2.weight": (256, 128, 1, 1),
    "update.corr_encoder.0.weight": (128, 196, 1, 1),
    "update.flow_encoder.0.weight": (128, 4, 7, 7),
    "update.gru.convz.weight": (128, 448, 3, 3),
    "update.gru.convq_glo.weight": (128, 128, 1, 1),
    "update.agg.upmask.0.weight": (576, 128, 1, 1),
}
_HEADS = ("update.weight.2.weight", "update.delta.2.weight")  # the engine uses their first two rows


def check_weights(path: Path, load: Any) -> None:
    """Check the names and shapes of a checkpoint. Raises TrackerError.

    load: reads a file into a mapping of names to tensors, as torch.load does.
    """
    try:
        whole = zipfile.is_zipfile(path) or path.stat().st_size < 1000
        state = load(path) if whole else None
    except OSError as error:
        raise TrackerError(f"{path}: cannot be read ({error.strerror})") from None
    except Exception as error:  # torch.load raises whatever a file makes it raise
        raise TrackerError(f"{path}: not a checkpoint ({type(error).__name__})") from None
    if state is None:
        raise TrackerError(f"{path}: truncated, or not a checkpoint of PyTorch 1.6 or later")
    shapes = {name.removeprefix("module."): tuple(tensor.shape) for name, tensor in state.items() if hasattr(tensor, "shape")}
    for name, shape in SHAPES.items():
        if shapes.get(name) != shape:
            raise TrackerError(f"{path}: not the weights of DROID-SLAM: {name} has shape {shapes.get(name)}, want {shape}")
    for name in _HEADS:
        rows, *rest = shapes.get(name, (0,))
        if rows < 2 or rest != [128, 3, 3]:
            raise TrackerError(f"{path}: not the weights of DROID-SLAM: {name} has shape {shapes.get(name)}")


class Droid:
    """TrackingEngine protocol over DROID-SLAM in its RGB-D mode.

    Raises TrackerError if PyTorch, the checkout or the weights are missing or wrong.
    """

    def __init__(self, weights: Path, camera: Intrinsics) -> None:
        try:
            self._torch: Any = importlib.import_module("torch")
        except ImportError:
            raise TrackerError("droid: PyTorch is not installed") from None
        check_weights(weights, lambda path: self._torch.load(path, map_location="cpu", weights_only=True))
        try:
            engine: Any = importlib.import_module("droid")
        except ImportError as error:
            raise TrackerError(f"droid cannot be imported ({error}): put droid_slam/ of its checkout on PYTHONPATH") from None
        if not self._torch.cuda.is_available():
            raise TrackerError("droid: needs an NVIDIA GPU, and PyTorch finds none")
        height, width = image_size(camera)
        self._size = (height, width)
        scale = np.array([width / camera.width, height / camera.height])
        middle = (np.array([camera.cx, camera.cy]) + 0.5) * scale - 0.5
        lens = [camera.fx * scale[0], camera.fy * scale[1], *middle]
        self._lens = self._torch.as_tensor(lens, dtype=self._torch.float32)
        self._engine = engine.Droid(arguments(weights, self._size))
        self._given = 0
        self._begin_s: float | None = None
        self._stamps_s: list[float] = []

    def track(self, view: RgbdView) -> list[TrackedPose]:
        """Track a view, and return the poses of the keyframes that are settled by now."""
        torch, video = self._torch, self._engine.video
        resize = torch.nn.functional.interpolate
        rgb = torch.as_tensor(np.array(view.rgb[..., ::-1])).permute(2, 0, 1)[None].float()
        depth = torch.as_tensor(np.array(view.depth_m))[None, None]
        small = resize(rgb, self._size, mode="bilinear", align_corners=False).to(torch.uint8)
        self._stamps_s.append(view.stamp_s)  # the engine keeps stamps as float32: it gets their number
        number = len(self._stamps_s) - 1
        self._engine.track(number, small, resize(depth, self._size, mode="nearest")[0, 0], intrinsics=self._lens)
        done = max(int(video.counter.value) - _LAG, 0)
        numbers = video.tstamp[self._given : done].cpu().numpy()
        poses = video.poses[self._given : done].cpu().numpy()
        self._given = max(done, self._given)
        return [
            TrackedPose(self._stamps_s[round(float(at))], keyframe_pose(row), 100)
            for at, row in zip(numbers, poses, strict=True)
        ]

    def close(self) -> None:
        """Do nothing."""


def image_size(camera: Intrinsics) -> tuple[int, int]:
    """Return height and width of the images for the network."""
    scale = (_PIXELS / (camera.width * camera.height)) ** 0.5
    height, width = (max(round(side * scale) // _CELL_PX, 4) * _CELL_PX for side in (camera.height, camera.width))
    return height, width


def keyframe_pose(row: np.ndarray[Any, np.dtype[np.float32]]) -> Pose:
    """Return world_from_rgb of a pose of the engine.

    row (7,): translation and quaternion xyzw of rgb_from_world.
    """
    x, y, z, w = row[3:].tolist()
    return Pose(np.array([w, x, y, z]), row[:3].astype(np.float64)).inverse()


def arguments(weights: Path, size: tuple[int, int]) -> Namespace:
    """Return the options of the engine, with the defaults of its own program."""
    return Namespace(
        weights=str(weights), image_size=list(size), buffer=_BUFFER, stereo=False, disable_vis=True, upsample=False,
        beta=0.3, filter_thresh=2.4, warmup=8, keyframe_thresh=4.0, frontend_thresh=16.0, frontend_window=25,
        frontend_radius=2, frontend_nms=1, backend_thresh=22.0, backend_radius=2, backend_nms=3,
        asynchronous=False, frontend_device="cuda", backend_device="cuda",
    )  # fmt: skip
