"""Camera values: intrinsics, frames, inertial samples."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from uav_recon.types.camera_calibration import CameraCalibration
from uav_recon.types.frames import ByteArray, Float32Array, FloatArray, frozen
from uav_recon.types.pose import Pose

# optical RDF axes seen from a level FLU body that looks along x
BODY_FROM_OPTICAL = np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """Pinhole camera without distortion, in pixels.

    Pixel (0, 0) is the CENTRE of the top-left pixel.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    @staticmethod
    def from_fov(width: int, height: int, horizontal_rad: float, vertical_rad: float) -> Intrinsics:
        """Build from full angles of view, with the principal point in the middle."""
        return Intrinsics(
            fx=width / 2 / float(np.tan(horizontal_rad / 2)),
            fy=height / 2 / float(np.tan(vertical_rad / 2)),
            cx=(width - 1) / 2,
            cy=(height - 1) / 2,
            width=width,
            height=height,
        )

    @staticmethod
    def from_tree(tree: Any) -> Intrinsics:
        """Return the intrinsics of a JSON object with fx, fy, cx, cy, width and height.

        Raises ValueError, KeyError or TypeError for anything but finite numbers, fx and fy positive, width and height whole
        and positive.
        """
        values = {name: tree[name] for name in ("fx", "fy", "cx", "cy", "width", "height")}
        for name, value in values.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise ValueError(f"intrinsics: {name} {value!r} is not a number")
            if name in ("width", "height") and not isinstance(value, int):
                raise ValueError(f"intrinsics: {name} {value!r} is not a whole number")
            if not name.startswith("c") and value <= 0:
                raise ValueError(f"intrinsics: {name} {value!r} is not positive")
        return Intrinsics(**values)

    def pinhole_px(self) -> FloatArray:
        """Return fx, fy, cx, cy as an array (4,), the form that kernels use."""
        return np.array([self.fx, self.fy, self.cx, self.cy])

    def bearings(self) -> FloatArray:
        """Return the direction through each pixel with z = 1, shape (height, width, 3)."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return np.stack([(u - self.cx) / self.fx, (v - self.cy) / self.fy, np.ones_like(u, dtype=np.float64)], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One RGB-D frame.

    depth_m: (H, W) float32 along the optical axis, NaN = no return. rgb: (h, w, 3) uint8 sRGB.

    A D435i's depth is wider than its colour: geometry comes from all depth, colour where there is colour.
    rgb_from_depth transforms a point from the depth frame into the colour frame.
    """

    stamp_s: float
    sequence: int
    depth_m: Float32Array
    depth_intrinsics: Intrinsics
    rgb: ByteArray
    rgb_intrinsics: Intrinsics
    rgb_from_depth: Pose

    def __post_init__(self) -> None:
        object.__setattr__(self, "depth_m", frozen(np.asarray(self.depth_m, dtype=np.float32)))
        object.__setattr__(self, "rgb", frozen(np.asarray(self.rgb, dtype=np.uint8)))


@dataclass(frozen=True, slots=True, eq=False)
class PosedFrame:
    """A frame and the pose of its depth imager when it saw what the frame shows.

    calibration: errors of the camera that depth and pose have been corrected for. velocity_mps (3,), rate_radps (3,): motion of
    the imager at that instant, in world axes.
    unsure: the source of the poses is uncertain of the place. The frame shows that the camera works, and is not mapped.
    place_sigma_m: standard deviation of the place in its worst direction, by the covariance of the pose; NaN if unknown.
    """

    frame: Frame
    world_from_depth: Pose
    map_epoch: int = 0
    unsure: bool = False
    place_sigma_m: float = math.nan
    calibration: CameraCalibration = field(default_factory=CameraCalibration.none)
    velocity_mps: FloatArray = field(default_factory=lambda: np.zeros(3))
    rate_radps: FloatArray = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True, slots=True, eq=False)
class ImuSample:
    """One inertial sample in body FLU axes.

    gyro_radps: angular rate (3,) rad/s. specific_force_mps2: specific force (3,) m/s², NaN if it was not measured.
    """

    stamp_s: float
    gyro_radps: FloatArray
    specific_force_mps2: FloatArray


def body_from_camera(position_body_m: FloatArray, pitch_down_rad: float) -> Pose:
    """Return the pose of an optical camera on the body, looking forward and tilted down.

    position_body_m: (3,) position of the camera on the body.
    """
    tilt = Pose(np.array([np.cos(pitch_down_rad / 2), 0.0, np.sin(pitch_down_rad / 2), 0.0]), position_body_m)
    return tilt @ Pose.from_matrix(BODY_FROM_OPTICAL)
