"""Model of an Intel RealSense D435i: stereo depth with noise and holes, and a colour camera.

Depth has 87x58 degrees, colour 69x42 degrees, both 424x240 pixels; the colour imager sits 15 mm to the left of the left
infrared imager, in which depth is expressed. Stereo is matched at 848x480 and delivered at half of that, so the disparity
error is in pixels of the matched image: sigma_z = z² · 0.08 px / (f · b), which is 14 mm at 2 m for f = 447 px, b = 5 cm.

The models `fast` and `small` are the same device with depth decimated once more and six images a second; `fast` has no
colour, `small` has colour decimated in the same ratio. `wide` has colour registered to depth.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sitl.camera.camera_errors import CameraErrors, TimingErrors
from sitl.camera.camera_mount import CameraMount, small_rigid
from sitl.camera.camera_view import CameraView
from sitl.camera.colour_camera import ColourLens, colour_camera
from sitl.camera.frame_exposure import FrameExposure
from sitl.geometry.quaternion import Quat
from sitl.geometry.transform import inverse, rigid
from sitl.runtime.jit import kernel
from sitl.scene.rasterizer import Renderer
from uav_recon.sensors.stream_format import CameraSpec, StreamHeader

WIDTH = 424
HEIGHT = 240
RANGE_M = (0.3, 6.0)
FAR_MARGIN_M = 0.6  # rendered beyond the range, because noise may move such a surface into it
BASELINE_M = 0.050
DISPARITY_ERROR_PX = 0.08
MATCHED_BINNING = 2  # width of the matched image divided by that of the delivered one
CORRELATION_SIGMA_PX = 1.5
CORRELATION_TAPS = 9
GRAZING_COS = 0.175
GRAZING_SPREAD = 0.02
MOUNT_M = (0.10, 0.0, 0.0)  # depth imager in the body
COLOUR_FROM_DEPTH_M = (0.015, 0.0, 0.0)
EXACT = CameraErrors()

Model = Literal["d435i", "wide", "fast", "small"]
Noise = Literal["d435i", "paper", "kinect", "none"]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
U16 = NDArray[np.uint16]


def pinhole(width: int, height: int, horizontal_deg: float, vertical_deg: float) -> CameraSpec:
    """Return the intrinsics of an image whose outer pixel EDGES span the two angles."""
    fx = 0.5 * width / math.tan(math.radians(0.5 * horizontal_deg))
    fy = 0.5 * height / math.tan(math.radians(0.5 * vertical_deg))
    return CameraSpec(width, height, fx, fy, 0.5 * (width - 1), 0.5 * (height - 1))


DEPTH_SPEC = pinhole(WIDTH, HEIGHT, 87.0, 58.0)
COLOUR_SPEC = pinhole(WIDTH, HEIGHT, 69.0, 42.0)
FAST_DEPTH_SPEC = pinhole(WIDTH // 2, HEIGHT // 2, 87.0, 58.0)
SMALL_COLOUR_SPEC = pinhole(WIDTH // 2, HEIGHT // 2, 69.0, 42.0)
NO_COLOUR_SPEC = pinhole(4, 2, 69.0, 42.0)
RATES_HZ: dict[Model, float] = {"d435i": 10.0, "wide": 10.0, "fast": 6.0, "small": 6.0}


def stream_header(model: Model) -> StreamHeader:
    """Return both cameras' intrinsics and the pose between them.

    `wide` has colour registered to depth; `fast` has a black colour image of 4x2 pixels.
    """
    if model == "wide":
        return StreamHeader(DEPTH_SPEC, DEPTH_SPEC, (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    if model in ("fast", "small"):
        colour = SMALL_COLOUR_SPEC if model == "small" else NO_COLOUR_SPEC
        return StreamHeader(FAST_DEPTH_SPEC, colour, (1.0, 0.0, 0.0, 0.0, *COLOUR_FROM_DEPTH_M))
    return StreamHeader(DEPTH_SPEC, COLOUR_SPEC, (1.0, 0.0, 0.0, 0.0, *COLOUR_FROM_DEPTH_M))


class SimulatedD435i:
    """Camera in a scene. Frame n of a seed has the same noise in every run. Not thread-safe.

    The header is nominal; the camera has the given errors against it. Timing errors and lost frames are not its own: they are
    in the exposures that it gets.
    """

    def __init__(
        self,
        renderer: CameraView,
        model: Model = "d435i",
        noise: Noise = "d435i",
        seed: int = 0,
        errors: CameraErrors = EXACT,
    ) -> None:
        self.header = stream_header(model)
        self.period_s = 1.0 / RATES_HZ[model]
        self.renderer = renderer
        self._seed = seed
        self._noise = _NOISES[noise]
        self._frames = 0
        self._mount = CameraMount(MOUNT_M, errors.mount)
        optics, wide = errors.optics, model == "wide"
        self._depth_spec = _longer(self.header.depth, optics.depth_focal)
        self._depth_factor = np.float32(1.0 + optics.depth_scale)
        self._far_m = math.inf if wide else RANGE_M[1] + FAR_MARGIN_M
        tx, ty, tz = self.header.rgb_from_depth[4:]
        depth_from_rgb = inverse(rigid(np.eye(3), (tx, ty, tz)))
        lens = ColourLens(
            _longer(self.header.rgb, optics.colour_focal),
            depth_from_rgb @ small_rigid(optics.colour_rotation_rad, optics.colour_translation_m),
            self._mount,
        )
        self._colour = colour_camera(model == "fast", wide, lens, errors)

    def turn(self, quat_wxyz: Quat) -> None:
        """Turn depth and colour imager about the body's origin, body axes, which nobody is told."""
        self._mount.turn(quat_wxyz)

    def capture(self, world_from_body: F64, pitch_down_rad: float, stamp_s: float = 0.0) -> tuple[U16, U8]:
        """Return the images of expose() from a body pose (4, 4) at rest."""
        return self.expose(FrameExposure.at_rest(stamp_s, world_from_body, pitch_down_rad))

    def expose(self, exposure: FrameExposure) -> tuple[U16, U8]:
        """Return depth (H, W) in mm, 0 = no return, and rgb (h, w, 3).

        Blocks for about 20 ms, `fast` for 2 ms.
        """
        world_from_depth, coloured = self._mount.world_from_depth(exposure.depth), self._colour.in_depth_view
        view = self.renderer.render(world_from_depth, self._depth_spec, far_m=self._far_m, colour=coloured)
        rng = np.random.default_rng([self._seed, self._frames])
        self._frames += 1
        depth_mm = self._noise(view.depth_m * self._depth_factor, view.incidence_cos, rng)
        return depth_mm, self._colour.image(self.renderer, exposure, view)


def _longer(spec: CameraSpec, share: float) -> CameraSpec:
    """Return the intrinsics with both focal lengths longer by a share."""
    return replace(spec, fx=spec.fx * (1.0 + share), fy=spec.fy * (1.0 + share))


def warm_up() -> None:
    """Compile all kernels of this module, of the colour camera and of the renderer."""
    vertices = np.array([[1, -1, -1], [1, 1, -1], [1, 0, 1]], np.float32)
    scene = Renderer(vertices, np.array([[0, 1, 2]], np.int32), np.zeros((3, 3), np.uint8))
    SimulatedD435i(scene, errors=CameraErrors(timing=TimingErrors(readout_s=0.01))).capture(np.eye(4), 0.0)


def _stereo(depth_m: F32, incidence_cos: F32, rng: np.random.Generator) -> U16:
    (height, width), pad = depth_m.shape, CORRELATION_TAPS - 1
    coarser = WIDTH / width  # the constants hold for images of WIDTH
    white = rng.standard_normal((height + pad, width + pad), np.float32)
    return _stereo_depth(
        depth_m,
        incidence_cos,
        _smooth(white, _taps(CORRELATION_SIGMA_PX / coarser)),
        white[::-1, ::-1],  # reversed: loss at grazing incidence is independent of the pixel's depth error
        DEPTH_SPEC.fx / coarser * BASELINE_M,
        DISPARITY_ERROR_PX / MATCHED_BINNING / coarser,
    )


def _paper(depth_m: F32, incidence_cos: F32, rng: np.random.Generator) -> U16:
    """Return depth (mm) with white noise of sigma = 3 mm at 3 m, growing with z²."""
    return _white(depth_m, 0.003 * (depth_m / 3.0) ** 2, rng)


def _kinect(depth_m: F32, incidence_cos: F32, rng: np.random.Generator) -> U16:
    """Return depth (mm) with white noise of sigma = 0.001 + 0.0019 (z - 0.4)² m.

    Axial noise of Nguyen, Izadi, Lovell 2012.
    """
    return _white(depth_m, 0.001 + 0.0019 * (depth_m - 0.4) ** 2, rng)


def _exact(depth_m: F32, incidence_cos: F32, rng: np.random.Generator) -> U16:
    return _white(depth_m, np.zeros_like(depth_m), rng)


_NOISES: dict[str, Callable[[F32, F32, np.random.Generator], U16]] = {
    "d435i": _stereo,
    "paper": _paper,
    "kinect": _kinect,
    "none": _exact,
}


def _white(depth_m: F32, sigma_m: F32, rng: np.random.Generator) -> U16:
    noisy = depth_m + sigma_m * rng.standard_normal(depth_m.shape, np.float32)
    seen = (noisy >= RANGE_M[0]) & (noisy <= RANGE_M[1]) & (depth_m > 0)
    return np.where(seen, np.rint(noisy * 1000.0), 0.0).astype(np.uint16)


def _taps(sigma_px: float) -> F32:
    """Return Gaussian weights whose squares sum to 1: a blur keeps the variance of white noise."""
    x = np.arange(CORRELATION_TAPS) - CORRELATION_TAPS // 2
    weights = np.exp(-0.5 * (x / sigma_px) ** 2)
    return np.asarray((weights / np.sqrt((weights**2).sum())).astype(np.float32))


@kernel
def _smooth(white: F32, taps: F32) -> F32:
    """Return the valid part of a separable convolution: (H + t - 1, W + t - 1) -> (H, W)."""
    n = taps.shape[0]
    height, width = white.shape[0] - n + 1, white.shape[1] - n + 1
    rows = np.zeros((height, white.shape[1]), np.float32)
    out = np.zeros((height, width), np.float32)
    for v in range(height):
        for k in range(n):
            for u in range(white.shape[1]):
                rows[v, u] += taps[k] * white[v + k, u]
        for k in range(n):
            for u in range(width):
                out[v, u] += taps[k] * rows[v, u + k]
    return out


@kernel
def _stereo_depth(depth_m: F32, incidence_cos: F32, error: F32, white: F32, focal_baseline: float, error_px: float) -> U16:
    """Return depth (H, W) in mm, 0 without a return, with the errors of stereo matching.

    z' = f b / (f b / z + error). A pixel has no return where its ray from the second imager is occluded by a nearer
    surface (a band at the left of every near object) or outside that imager, at grazing incidence, and beyond the range.
    """
    height, width = depth_m.shape
    out = np.zeros((height, width), np.uint16)
    for v in range(height):
        leftmost = 1e9  # smallest column in the second imager of all pixels to the right
        for back in range(width):
            u = width - 1 - back
            if depth_m[v, u] <= 0:
                continue
            disparity = focal_baseline / depth_m[v, u]
            column = u - disparity
            hidden = column > leftmost - 0.25
            leftmost = min(leftmost, column)
            if hidden or column < -0.5 or incidence_cos[v, u] < GRAZING_COS + GRAZING_SPREAD * white[v, u]:
                continue
            noisy = disparity + error_px * error[v, u]
            if noisy <= 0:
                continue
            z = focal_baseline / noisy
            if RANGE_M[0] <= z <= RANGE_M[1]:
                out[v, u] = np.uint16(z * 1000.0 + 0.5)
    return out
