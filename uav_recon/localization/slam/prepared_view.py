"""RGB-D frame of the tracker: points of depth, brightness of colour, depth at a corner."""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.localization.slam.depth_image import DepthImage, grid_points
from uav_recon.localization.slam.optical_flow import brightness
from uav_recon.types.camera import Frame
from uav_recon.types.frames import AnyArray, ByteArray, FloatArray
from uav_recon.types.pose import Pose

_POINTS = 1600  # of depth that are compared with the map
_WIDEST_PX = 640
_NARROWEST_PX = 32
_FARTHEST_M = 6.0
# inverse depths around a corner that bend by more are those of two objects; noise of a D435i bends them by 0.01 per metre
_MAX_BEND_PER_M = 0.03
_MAX_BEND_SHARE = 0.02
_SPAN_PX = 2
_FIRST_M = 2.0  # first guess of a depth
_ROUNDS = 4


class PreparedView:
    """A frame prepared once.

    ``depth``: smaller. ``points`` (N, 3): of depth, in the depth imager's frame. ``grey`` (h, w): brightness, None for a camera
    without colour; ``camera`` (4,): its fx, fy, cx, cy. ``depth_from_rgb``: pose of the colour imager.
    """

    def __init__(self, frame: Frame) -> None:
        self.frame = frame
        self.depth = DepthImage.of(frame)
        self.points = grid_points(self.depth.depth_m, self.depth.camera, _POINTS)
        self.depth_from_rgb = frame.rgb_from_depth.inverse()
        self.grey: ByteArray | None = None
        self.camera = frame.rgb_intrinsics.pinhole_px()
        if min(frame.rgb.shape[:2]) >= _NARROWEST_PX:
            self.grey, smaller = brightness(frame.rgb, _WIDEST_PX)
            middle_px = (self.camera[2:] + 0.5) * smaller - 0.5  # pixel (0, 0) is its centre
            self.camera = np.concatenate((self.camera[:2] * smaller, middle_px))

    def rgb_pose(self, odom_from_depth: Pose) -> tuple[FloatArray, FloatArray]:
        """Return rotation (3, 3) and translation (3,) of the colour imager in odom.

        At the instant of the depth image.
        """
        odom_from_rgb = odom_from_depth @ self.depth_from_rgb
        return odom_from_rgb.rotation(), odom_from_rgb.translation_m


@kernel
def corner_places(
    at_px: AnyArray, camera: AnyArray, depth_m: AnyArray, depth_camera: AnyArray, rgb_from_depth: AnyArray, offset_m: AnyArray
) -> AnyArray:
    """Return the places (N, 3) of pixels (N, 2) of the colour image, NaN where not known.

    The places are in the colour imager's frame. The depth on the ray of a pixel is found by iteration: the present depth gives
    the pixel of the depth image, and this pixel the next depth.
    rgb_from_depth (3, 3), offset_m (3,): pose of the depth imager in the colour imager.
    """
    height, width = depth_m.shape
    out = np.full((at_px.shape[0], 3), np.nan)
    for n in range(at_px.shape[0]):
        x, y = (at_px[n, 0] - camera[2]) / camera[0], (at_px[n, 1] - camera[3]) / camera[1]
        z, u, v, ok = _FIRST_M, 0, 0, True
        for _ in range(_ROUNDS):
            a, b, c = x * z - offset_m[0], y * z - offset_m[1], z - offset_m[2]
            p = rgb_from_depth[0, 0] * a + rgb_from_depth[1, 0] * b + rgb_from_depth[2, 0] * c
            q = rgb_from_depth[0, 1] * a + rgb_from_depth[1, 1] * b + rgb_from_depth[2, 1] * c
            r = rgb_from_depth[0, 2] * a + rgb_from_depth[1, 2] * b + rgb_from_depth[2, 2] * c
            ok = r > 0.0
            if not ok:
                break
            u = int(np.rint(p / r * depth_camera[0] + depth_camera[2]))
            v = int(np.rint(q / r * depth_camera[1] + depth_camera[3]))
            ok = _SPAN_PX <= u < width - _SPAN_PX and _SPAN_PX <= v < height - _SPAN_PX
            if not ok:
                break
            d = float(depth_m[v, u])
            ok = 0.0 < d <= _FARTHEST_M
            if not ok:
                break
            # along the optical axis of the colour imager
            p, q = (u - depth_camera[2]) / depth_camera[0] * d, (v - depth_camera[3]) / depth_camera[1] * d
            z = rgb_from_depth[2, 0] * p + rgb_from_depth[2, 1] * q + rgb_from_depth[2, 2] * d + offset_m[2]
        if ok and _is_flat(depth_m, u, v):
            out[n, 0], out[n, 1], out[n, 2] = x * z, y * z, z
    return out


@kernel
def _is_flat(depth_m: AnyArray, u: int, v: int) -> bool:
    """Return True if the depths around a pixel are those of one plane, seen at any angle.

    The inverse depth of a plane is linear in the image: it is the mean of those on opposite sides.
    """
    here = 1.0 / float(depth_m[v, u])
    most = _MAX_BEND_PER_M + _MAX_BEND_SHARE * here
    for dv, du in ((0, _SPAN_PX), (_SPAN_PX, 0), (_SPAN_PX, _SPAN_PX), (_SPAN_PX, -_SPAN_PX)):
        before, after = float(depth_m[v - dv, u - du]), float(depth_m[v + dv, u + du])
        if not (before > 0.0 and after > 0.0 and abs(1.0 / before + 1.0 / after - 2.0 * here) < most):
            return False
    return True
