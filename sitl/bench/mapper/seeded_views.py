"""Input of the mapper benchmark: views of the simulated camera, and visible ground truth.

This is a composition root: it requests images and ground truth from the simulator and converts them to the product's types.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, cast

import numpy as np

from uav_recon.app.option_validation import UsageError
from uav_recon.evaluation.triangle_surface import TriangleSurface
from uav_recon.sensors.stream_camera import depth_lookup_table
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame
from uav_recon.types.frames import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from uav_recon.types.pose import Pose

if TYPE_CHECKING:
    from sitl.apps.scene_captures import SceneCaptures
    from sitl.camera.d435i import Model, Noise

TRUTH_POINTS = 300_000
TRUTH_SEED = 20240319
# images, and pixel spacing in the comparison
HELD_OUT = 20
HELD_OUT_STRIDE = 4
CAMERAS = ("d435i", "wide")
DEPTH_RANGE_M = (0.3, 6.0)
VIEW_PERIOD_S = 0.5


@dataclass(frozen=True)
class SceneOptions:
    """The user's options, with the values of `uav-recon sim`.

    pose_sigma: standard deviation of the pose noise on each axis, m and rad. camera_errors: None: the default of `sim`.
    """

    scene: str | None
    views: int
    camera: str
    depth_noise: str
    mount: str
    pose_sigma: tuple[float, float]
    seed: int
    camera_errors: str | None = None


@dataclass(frozen=True, eq=False)
class ImageRays:
    """Held-out pixels whose surface some view saw in depth and colour.

    origin, direction: (N, 3) rays in world.
    rgb: (N, 3) true colour.
    picture: (N,) number of the image of each pixel, ascending.
    """

    origin: Float32Array
    direction: Float32Array
    rgb: ByteArray
    picture: IntArray


@dataclass(frozen=True, eq=False)
class MapperScene:
    """A scene with its keyframes and ground truth.

    keyframes: in order of capture, with noisy poses.
    surface: the whole scene, in world.
    points: (N, 3) drawn on the surface by area; those that some view got a depth return from.
    coloured: (N,) True if a colour image shows the point too.
    pictures: held-out pixels for the comparison of colours.
    """

    name: str
    low_m: FloatArray
    high_m: FloatArray
    depth_noise_px: float
    keyframes: tuple[PosedFrame, ...]
    surface: TriangleSurface
    points: FloatArray
    coloured: BoolArray
    pictures: ImageRays


def load(options: SceneOptions, say: Callable[[str], None] = lambda _: None) -> MapperScene:
    """Capture the views. Raises UserError with one line for bad input.

    Takes half a minute; the visible ground truth is cached. say(what) is called at each step.
    """
    from sitl.apps import scene_captures as outside
    from sitl.apps.flight_config import NOISE_PX, mount_pitch_down_deg
    from sitl.apps.flight_judge import visible_truth
    from sitl.apps.sim_options import SimOptions
    from sitl.camera.camera_errors import CameraErrors
    from sitl.scene.mesh_sampling import area_weighted_samples
    from sitl.scene.scene import SceneError, load_scene

    if options.camera not in CAMERAS:
        raise UsageError(f"--camera {options.camera}: want one of {', '.join(CAMERAS)}")
    wanted = SimOptions(
        scene=options.scene,
        seed=options.seed,
        mount=options.mount,
        depth_noise=options.depth_noise,
        camera=options.camera,
        camera_errors=options.camera_errors,
    )
    try:
        scene = load_scene(wanted.scene)
    except SceneError as error:
        raise UsageError(str(error)) from None
    say("cutting truth to what the vehicle could see")
    cut = visible_truth(wanted, scene)
    pitch_deg = mount_pitch_down_deg(wanted.mount)
    say(f"taking {options.views} views")
    taken = outside.capture(
        scene, cut.positions, None if pitch_deg is None else float(np.deg2rad(pitch_deg)),
        cast("Model", options.camera), cast("Noise", options.depth_noise), options.views, options.seed,
        CameraErrors.drawn(options.seed, wanted.camera_error_scale, gimbal=pitch_deg is None),
    )  # fmt: skip
    say("finding what they saw")
    samples, normals = area_weighted_samples(scene.vertices, scene.faces, TRUTH_POINTS, TRUTH_SEED)
    pixels = outside.held_out_pixels(scene, cut.views[:HELD_OUT], cut.view_spec, HELD_OUT_STRIDE)
    looks, coloured = outside.seen(
        scene, taken, np.concatenate([samples, pixels.point]), np.concatenate([normals, pixels.normal])
    )
    seen, shown = looks[: len(samples)] > 0, coloured[len(samples) :]
    return MapperScene(
        scene.name,
        scene.fence_min,
        scene.fence_max,
        NOISE_PX[options.depth_noise],
        _keyframes(taken, options),
        TriangleSurface(scene.vertices.astype(np.float64), scene.faces.astype(np.int64)),
        samples[seen].astype(np.float64),
        coloured[: len(samples)][seen],
        ImageRays(pixels.origin[shown], pixels.direction[shown], pixels.rgb[shown], pixels.picture[shown]),
    )


def exposures(scene: MapperScene, max_ev: float, seed: int) -> FloatArray:
    """Return a random exposure (V,) in EV for each view, uniform in ± max_ev."""
    return np.random.default_rng([seed, 2]).uniform(-max_ev, max_ev, len(scene.keyframes))


def exposed(scene: MapperScene, ev: FloatArray) -> MapperScene:
    """Return the same views, each with its exposure (V,), and the held-out images with the mean.

    The mean exposure is what a map of all views shows, because no view defines the correct one.
    """
    keyframes = [
        replace(k, frame=replace(k.frame, rgb=_brighter(stops)[k.frame.rgb]))
        for k, stops in zip(scene.keyframes, ev, strict=True)
    ]
    pictures = replace(scene.pictures, rgb=_brighter(float(ev.mean()))[scene.pictures.rgb])
    return replace(scene, keyframes=tuple(keyframes), pictures=pictures)


def _brighter(ev: float) -> ByteArray:
    """Return the new value of each sRGB value (256,): linear light times 2**ev, clipped."""
    value = np.arange(256) / 255.0
    light = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1
    light = np.clip(light * 2.0**ev, 0.0, 1.0)
    shown = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)
    table: ByteArray = np.rint(255.0 * shown).astype(np.uint8)
    return table


def _keyframes(taken: SceneCaptures, options: SceneOptions) -> tuple[PosedFrame, ...]:
    """Convert the captures to keyframes and add the pose noise."""
    metres = depth_lookup_table(*DEPTH_RANGE_M)
    header, rng = taken.header, np.random.default_rng([options.seed, 1])
    depth, rgb = (Intrinsics(c.fx, c.fy, c.cx, c.cy, c.width, c.height) for c in (header.depth, header.rgb))
    mounted = np.array(header.rgb_from_depth)
    sigma_m, sigma_rad = options.pose_sigma
    keyframes = []
    for n in range(len(taken.depth_mm)):
        frame = Frame(n * VIEW_PERIOD_S, n, metres[taken.depth_mm[n]], depth, taken.rgb[n], rgb, Pose(mounted[:4], mounted[4:]))
        true, shift, turn = Pose.from_matrix(taken.world_from_depth[n]), rng.normal(size=3), rng.normal(size=3)
        given = Pose.from_rotation_vector(sigma_rad * turn, np.zeros(3)) @ Pose(true.quat_wxyz, np.zeros(3))
        keyframes.append(PosedFrame(frame, Pose(given.quat_wxyz, true.translation_m + sigma_m * shift)))
    return tuple(keyframes)
