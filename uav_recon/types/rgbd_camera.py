"""RGB-D camera for users of the library.

It holds both images' intrinsics, the mount, the range and the depth noise.
"""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass

import numpy as np
from numpy.typing import ArrayLike

from uav_recon.types.argument_checks import require_kind, require_number, require_pose, require_vector
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame, body_from_camera
from uav_recon.types.frames import AnyArray, Float32Array, FloatArray, frozen
from uav_recon.types.pose import Pose

_RANGE_SLACK_M = 1e-9  # as in the camera stream


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """An RGB-D camera on a fixed mount. Raises ValueError for a value that no camera has.

    depth, rgb: intrinsics of the two images. rgb_from_depth: carries a point from the depth frame to the colour frame.
    depth_min_m, depth_max_m: other depths become NaN. depth_noise_px: rms disparity error in pixels of the depth image;
    sigma_z = z² * depth_noise_px / (fx * baseline_m). baseline_m: stereo baseline. position_body_m (3,): depth imager on the
    body, FLU. pitch_down_rad: tilt of the mount, positive looks down.

    ``world_from_camera`` is everywhere the pose of the depth imager: optical frame (x right, y down, z forward), world ENU.
    """

    depth: Intrinsics
    rgb: Intrinsics
    rgb_from_depth: Pose
    _: KW_ONLY
    depth_min_m: float
    depth_max_m: float
    depth_noise_px: float
    baseline_m: float
    position_body_m: FloatArray
    pitch_down_rad: float

    def __post_init__(self) -> None:
        for name in ("depth", "rgb"):
            _require_intrinsics(name, getattr(self, name))
        require_pose("rgb_from_depth", self.rgb_from_depth)
        require_number("depth_min_m", self.depth_min_m, 0.0, 100.0)
        require_number("depth_max_m", self.depth_max_m, 0.0, 100.0)
        if not self.depth_min_m < self.depth_max_m:
            raise ValueError(f"depth_max_m: {self.depth_max_m:g}, expected more than depth_min_m {self.depth_min_m:g}")
        require_number("depth_noise_px", self.depth_noise_px, 1e-6, 10.0)
        require_number("baseline_m", self.baseline_m, 1e-4, 10.0)
        require_number("pitch_down_rad", self.pitch_down_rad, -math.pi / 2, math.pi / 2)
        object.__setattr__(self, "position_body_m", frozen(require_vector("position_body_m", self.position_body_m)))

    @staticmethod
    def d435i(*, position_body_m: ArrayLike = (0.10, 0.0, 0.0), pitch_down_rad: float = math.radians(15.0)) -> Camera:
        """Return an Intel RealSense D435i.

        Both images have 424x240 pixels. The angles of view are 87x58 degrees (depth) and 69x42 degrees (colour). Range,
        noise and mount are the defaults of [camera] in the configuration. Intrinsics are nominal; a device reports its own.
        """
        return Camera(
            Intrinsics.from_fov(424, 240, math.radians(87.0), math.radians(58.0)),
            Intrinsics.from_fov(424, 240, math.radians(69.0), math.radians(42.0)),
            Pose(np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.015, 0.0, 0.0])),
            depth_min_m=0.3,
            depth_max_m=6.0,
            depth_noise_px=0.04,
            baseline_m=0.05,
            position_body_m=require_vector("position_body_m", position_body_m),
            pitch_down_rad=pitch_down_rad,
        )

    @staticmethod
    def registered(
        intrinsics: Intrinsics,
        *,
        depth_min_m: float,
        depth_max_m: float,
        depth_noise_px: float,
        baseline_m: float,
        position_body_m: ArrayLike = (0.0, 0.0, 0.0),
        pitch_down_rad: float = 0.0,
    ) -> Camera:
        """Return a camera whose depth and colour images have the same pixels.

        Most RGB-D data sets have such images.
        """
        return Camera(
            intrinsics,
            intrinsics,
            Pose.identity(),
            depth_min_m=depth_min_m,
            depth_max_m=depth_max_m,
            depth_noise_px=depth_noise_px,
            baseline_m=baseline_m,
            position_body_m=require_vector("position_body_m", position_body_m),
            pitch_down_rad=pitch_down_rad,
        )

    def world_from_camera(self, world_from_body: Pose) -> Pose:
        """Return the pose of the depth imager for a pose of the body (FLU)."""
        body = require_pose("world_from_body", world_from_body)
        return body @ body_from_camera(self.position_body_m, self.pitch_down_rad)

    def frame(self, depth_m: AnyArray, rgb: AnyArray | None = None, *, stamp_s: float = 0.0) -> Frame:
        """Return a frame of this camera. Raises ValueError for a wrong shape or dtype.

        depth_m: (H, W) float32 or float64, metres along the optical axis; 0, infinite and NaN mean no return. Depths outside
        [depth_min_m, depth_max_m] become NaN, as in flight. rgb: (h, w, 3) uint8 sRGB; None is a black image, which is enough
        for an occupancy map.
        """
        require_number("stamp_s", stamp_s)
        colour_shape = (self.rgb.height, self.rgb.width, 3)
        colour = np.zeros(colour_shape, dtype=np.uint8) if rgb is None else np.asarray(rgb)
        if colour.shape != colour_shape:
            raise ValueError(f"rgb: shape {colour.shape}, expected {colour_shape}")
        if colour.dtype != np.uint8:
            raise ValueError(f"rgb: dtype {colour.dtype}, expected uint8")
        return Frame(stamp_s, 0, self._in_range(np.asarray(depth_m)), self.depth, colour, self.rgb, self.rgb_from_depth)

    def keyframe(self, depth_m: AnyArray, rgb: AnyArray | None, world_from_camera: Pose, *, stamp_s: float = 0.0) -> PosedFrame:
        """Return frame() with the pose of the depth imager.

        Raises ValueError as frame(), and for anything but a Pose.
        """
        return PosedFrame(self.frame(depth_m, rgb, stamp_s=stamp_s), require_pose("world_from_camera", world_from_camera))

    def _in_range(self, depth_m: AnyArray) -> Float32Array:
        """Return depths (H, W) as float32, NaN outside the range."""
        expected = (self.depth.height, self.depth.width)
        if depth_m.shape != expected:
            raise ValueError(f"depth_m: shape {depth_m.shape}, expected {expected}")
        if depth_m.dtype not in (np.float32, np.float64):
            raise ValueError(f"depth_m: dtype {depth_m.dtype}, expected float32 or float64 metres (millimetres / 1000)")
        valid = (depth_m >= self.depth_min_m - _RANGE_SLACK_M) & (depth_m <= self.depth_max_m + _RANGE_SLACK_M)
        return np.where(valid, depth_m, np.nan).astype(np.float32)


def _require_intrinsics(name: str, value: object) -> None:
    """Raise ValueError unless the value is the intrinsics of a possible image."""
    intrinsics = require_kind(name, value, Intrinsics)
    for number in ("fx", "fy"):
        require_number(f"{name}.{number}", getattr(intrinsics, number), 1e-3, 1e6)
    for number in ("cx", "cy"):
        require_number(f"{name}.{number}", getattr(intrinsics, number), -1e6, 1e6)
    for number in ("width", "height"):
        require_number(f"{name}.{number}", getattr(intrinsics, number), 2, 16384)
