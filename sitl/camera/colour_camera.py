"""Colour camera: none, registered to depth, with a global shutter or with a rolling one.

A rolling shutter reads the rows one after the other while the camera moves. The image is rendered once, at the pose of its
middle row and with a margin. Then each row is taken from this image as the moved camera sees it: each pixel's ray is carried
to the middle pose with the rendered depth. That costs about 1.5 ms an image. Surfaces that the middle pose does not see are
not exact: some pixels at the edges of near objects.
"""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sitl.camera.camera_errors import CameraErrors
from sitl.camera.camera_mount import CameraMount
from sitl.camera.camera_view import CameraView
from sitl.camera.colour_tone import ColourTone, tone_table
from sitl.camera.frame_exposure import FrameExposure, MountPose
from sitl.geometry.transform import inverse
from sitl.runtime.jit import fast_kernel
from sitl.scene.rasterizer import Rendering
from uav_recon.sensors.stream_format import CameraSpec

MARGIN_SHARE = 0.0125  # of the width, on each side: 5 of 424 pixels, what 60 deg/s turn in half of 30 ms
_FAR_W = 1e-3  # inverse depth where the rendered image shows no surface
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]


class ColourCamera(Protocol):
    """Source of the colour images of a frame.

    in_depth_view: True if it needs a depth view with colour.
    """

    in_depth_view: bool

    def image(self, view: CameraView, exposure: FrameExposure, depth_view: Rendering) -> U8:
        """Return rgb (h, w, 3). depth_view: the rendering of the frame's depth image, without noise."""
        ...


class NoColour:
    """A black image."""

    in_depth_view = False

    def __init__(self, spec: CameraSpec) -> None:
        self._spec = spec

    def image(self, view: CameraView, exposure: FrameExposure, depth_view: Rendering) -> U8:
        """Return the black image."""
        return np.zeros((self._spec.height, self._spec.width, 3), np.uint8)


class RegisteredColour:
    """The colour of each depth pixel, without errors."""

    in_depth_view = True

    def image(self, view: CameraView, exposure: FrameExposure, depth_view: Rendering) -> U8:
        """Return the colour of the depth view."""
        return depth_view.rgb


@dataclasses.dataclass(frozen=True)
class ColourLens:
    """True intrinsics of the colour camera, and its true pose.

    depth_from_rgb (4, 4): against the true depth imager on the mount.
    """

    spec: CameraSpec
    depth_from_rgb: F64
    mount: CameraMount

    def world_from_rgb(self, pose: MountPose) -> F64:
        """Return the true pose (4, 4) of the colour imager, RDF."""
        return self.mount.world_from_depth(pose) @ self.depth_from_rgb


class GlobalShutterColour:
    """Colour camera that exposes all rows at once, with constant exposure."""

    in_depth_view = False

    def __init__(self, lens: ColourLens) -> None:
        self._lens = lens

    def image(self, view: CameraView, exposure: FrameExposure, depth_view: Rendering) -> U8:
        """Render the image at the time of its middle row."""
        return view.render(self._lens.world_from_rgb(exposure.colour_middle), self._lens.spec).rgb


class RollingShutterColour:
    """Colour camera that reads row by row, with exposure and white balance that wander."""

    in_depth_view = False

    def __init__(self, lens: ColourLens, errors: CameraErrors) -> None:
        self._lens = lens
        self._tone = ColourTone(errors)
        s = lens.spec
        margin = self._margin = round(MARGIN_SHARE * s.width)
        self._rendered = CameraSpec(s.width + 2 * margin, s.height + 2 * margin, s.fx, s.fy, s.cx + margin, s.cy + margin)

    def image(self, view: CameraView, exposure: FrameExposure, depth_view: Rendering) -> U8:
        """Render the middle row's image, and take each row from it as the moving camera reads it."""
        first, middle, last = (
            self._lens.world_from_rgb(pose) for pose in (exposure.colour_first, exposure.colour_middle, exposure.colour_last)
        )
        seen, s = view.render(middle, self._rendered), self._lens.spec
        turn, shift = _motion(inverse(middle) @ first, inverse(middle) @ last)
        table = tone_table(self._tone.gains(exposure.stamp_s))
        lens = np.array([s.fx, s.fy, s.cx, s.cy])
        return _rows(seen.rgb, seen.depth_m, s.height, s.width, self._margin, lens, turn, shift, table)


def colour_camera(black: bool, registered: bool, lens: ColourLens, errors: CameraErrors) -> ColourCamera:
    """Return the variant for a device and its errors.

    black, registered: what an exact camera of this device has.
    """
    if black:
        return NoColour(lens.spec)
    if errors == CameraErrors(errors.seed):
        return RegisteredColour() if registered else GlobalShutterColour(lens)
    return RollingShutterColour(lens, errors)


def _motion(middle_from_first: F64, middle_from_last: F64) -> tuple[F64, F64]:
    """Return the camera's motion from the first to the last row, in the axes of the middle one.

    The rotation vector (3,), rad, of at most some degrees, and the translation (3,), m.
    """
    turned = middle_from_last[:3, :3] @ middle_from_first[:3, :3].T
    turn = 0.5 * np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
    return turn, middle_from_last[:3, 3] - middle_from_first[:3, 3]


@fast_kernel
def _rows(
    rgb: U8, depth_m: F32, height: int, width: int, margin: int, lens: F64, turn: F64, shift: F64, table: U8
) -> U8:  # fmt: skip
    """Return the image (height, width, 3) of a camera that moves while it reads its rows.

    rgb, depth_m: rendered at the middle of the motion, with a margin on all sides. Row v is seen from the pose at the share
    v / (height - 1) of the motion: the rotation vector turn and the translation shift. Bilinear between pixels; rays that
    leave the rendered image repeat its edge. table (3, 256): new values of each channel.
    """
    out = np.empty((height, width, 3), np.uint8)
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    bottom, right = np.float32(rgb.shape[0] - 1.01), np.float32(rgb.shape[1] - 1.01)
    zero, one, two, far = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(_FAR_W)
    x0, y0, steps, half = np.float32(cx + margin), np.float32(cy + margin), np.float32(256.0), np.float32(0.5)
    rx, ry, rz = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    z, column, row = np.empty(width, np.float32), np.empty(width, np.int32), np.empty(width, np.int32)
    for v in range(height):
        share = v / (height - 1.0) - 0.5
        wx, wy, wz = share * turn[0], share * turn[1], share * turn[2]
        tx, ty, tz = np.float32(share * shift[0] * fx), np.float32(share * shift[1] * fy), np.float32(share * shift[2])
        yn = (v - cy) / fy
        # the rotated ray of column u is base + slope * u: the rotation matrix to second order of the angle
        slope_x, base_x = fx * (1.0 - 0.5 * (wy * wy + wz * wz)), fx * ((0.5 * wx * wy - wz) * yn + 0.5 * wx * wz + wy)
        slope_y, base_y = fy * (0.5 * wx * wy + wz), fy * ((1.0 - 0.5 * (wx * wx + wz * wz)) * yn + 0.5 * wy * wz - wx)
        slope_z, base_z = 0.5 * wx * wz - wy, (0.5 * wy * wz + wx) * yn + 1.0 - 0.5 * (wx * wx + wy * wy)
        ax, bx, ay, by = np.float32(slope_x), np.float32(base_x), np.float32(slope_y), np.float32(base_y)
        az, bz, start, per = np.float32(slope_z), np.float32(base_z), np.float32(-cx / fx), np.float32(1.0 / fx)
        for u in range(width):
            xn = start + per * np.float32(u)
            rx[u], ry[u], rz[u] = bx + ax * xn, by + ay * xn, bz + az * xn
            # the depth is looked up where the rotation alone takes the ray; 2 - rz is its inverse, for it is nearly 1
            column[u] = np.int32(min(max(rx[u] * (two - rz[u]) + x0, zero), right) + half)
            row[u] = np.int32(min(max(ry[u] * (two - rz[u]) + y0, zero), bottom) + half)
        for u in range(width):
            z[u] = depth_m[row[u], column[u]]
        for u in range(width):
            w = one / z[u] if z[u] > zero else far
            over = one / (rz[u] + tz * w)
            column[u] = np.int32(min(max((rx[u] + tx * w) * over + x0, zero), right) * steps + half)
            row[u] = np.int32(min(max((ry[u] + ty * w) * over + y0, zero), bottom) * steps + half)
        for u in range(width):
            left, top, p, q = column[u] >> 8, row[u] >> 8, column[u] & 255, row[u] & 255
            for k in range(3):
                above = (256 - p) * np.int32(rgb[top, left, k]) + p * np.int32(rgb[top, left + 1, k])
                below = (256 - p) * np.int32(rgb[top + 1, left, k]) + p * np.int32(rgb[top + 1, left + 1, k])
                out[v, u, k] = table[k, ((256 - q) * above + q * below + 32768) >> 16]
    return out
