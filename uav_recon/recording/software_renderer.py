"""Software renderer for images of a finished model, without GL, display or large packages.

Back faces are not drawn, so the view into a room passes through its near walls and its ceiling.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import ByteArray, FloatArray, IntArray

_OVERSAMPLING = 2
_CREASE_STRENGTH = 0.35


@dataclass(frozen=True, slots=True, eq=False)
class RenderView:
    """Camera of a render.

    camera_from_world: (3, 3) rotation, optical RDF axes. eye_world_m: (3,). scale_px: focal length in pixels of a
    perspective view; pixels per metre of an orthographic one.
    """

    camera_from_world: FloatArray
    eye_world_m: FloatArray
    scale_px: float
    centre_px: tuple[float, float]
    width: int
    height: int
    orthographic: bool

    def project(self, points_world: FloatArray) -> FloatArray:
        """Return columns (N, 3): u and v in pixels, depth in metres along the axis."""
        camera = (np.asarray(points_world, dtype=np.float64) - self.eye_world_m) @ self.camera_from_world.T
        scale = self.scale_px if self.orthographic else self.scale_px / np.maximum(camera[:, 2], 1e-3)
        return np.column_stack(
            [camera[:, 0] * scale + self.centre_px[0], camera[:, 1] * scale + self.centre_px[1], camera[:, 2]]
        )


def corner_view(lower_m: FloatArray, upper_m: FloatArray, width: int, height: int, azimuth_rad: float) -> RenderView:
    """Return a view down onto a box (lower, upper corner) from outside, over a corner.

    The box and a strip of floor around it fill the image. azimuth_rad: direction from the middle of the box to the eye,
    about z from x.
    """
    elevation, half_angle = np.radians(46.0), np.radians(15.0)
    outward = np.array([np.cos(elevation) * np.cos(azimuth_rad), np.cos(elevation) * np.sin(azimuth_rad), np.sin(elevation)])
    rotation = _looking_along(-outward)
    centre = (np.asarray(lower_m) + upper_m) / 2
    corners = (_box_corners(lower_m, upper_m) - centre) @ rotation.T
    tangents = np.array([np.tan(half_angle), np.tan(half_angle) * height / width])
    # smallest distance at which every corner lies inside the view, with a margin of 4 %
    distance = float((np.abs(corners[:, :2]) / (0.96 * tangents) - corners[:, 2:]).max())
    view = RenderView(
        rotation, centre + distance * outward, width / 2 / tangents[0], (width / 2, height / 2), width, height, False
    )
    return _centred(view, _with_apron(lower_m, upper_m), 0.94)


def top_view(lower_m: FloatArray, upper_m: FloatArray, width: int, height: int) -> RenderView:
    """Return an orthographic view straight down.

    The longer side of the box lies along the longer side of the image.
    """
    size = np.asarray(upper_m) - lower_m
    turned = (size[1] > size[0]) == (width > height)
    right = np.array([0.0, 1.0, 0.0]) if turned else np.array([1.0, 0.0, 0.0])
    down = np.array([1.0, 0.0, 0.0]) if turned else np.array([0.0, -1.0, 0.0])
    rotation = np.stack([right, down, np.array([0.0, 0.0, -1.0])])
    eye = np.array([*((np.asarray(lower_m) + upper_m) / 2)[:2], upper_m[2] + 1.0])
    view = RenderView(rotation, eye, 100.0, (width / 2, height / 2), width, height, True)
    return _centred(view, _with_apron(lower_m, upper_m), 0.94)


def render(vertices_world: FloatArray, faces: IntArray, rgb: ByteArray, view: RenderView) -> ByteArray:
    """Return the image (height, width, 3) uint8 sRGB on white, softly lit.

    rgb (V, 3) uint8 per vertex.
    """
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    screen = view.project(vertices_world) * [_OVERSAMPLING, _OVERSAMPLING, 1.0]
    shade = _shade(_vertex_normals(np.asarray(vertices_world, dtype=np.float64), faces), view)
    linear = (np.asarray(rgb, dtype=np.float64) / 255.0) ** 2.2 * shade[:, None]
    height, width = view.height * _OVERSAMPLING, view.width * _OVERSAMPLING
    colour, depth = _rasterise(np.ascontiguousarray(screen), faces, linear, height, width, view.orthographic)
    colour *= _creases(depth, view)[..., None]
    seen = np.isfinite(depth)
    colour[~seen] = 1.0
    colour = colour.reshape(view.height, _OVERSAMPLING, view.width, _OVERSAMPLING, 3).mean(axis=(1, 3))
    return np.asarray(np.clip(colour, 0.0, 1.0) ** (1 / 2.2) * 255.0 + 0.5, dtype=np.uint8)


def facing_inwards(vertices_world: FloatArray, faces: IntArray, inside_world: FloatArray) -> IntArray:
    """Return the faces, all reversed if most of the area faces away from a point in the room.

    inside_world (3,): that point.
    """
    a, b, c = (np.asarray(vertices_world, dtype=np.float64)[faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    towards = inside_world - (a + b + c) / 3
    towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
    turned: IntArray = faces if float((normal * towards).sum()) >= 0.0 else faces[:, ::-1]
    return turned


def _looking_along(forward: FloatArray) -> FloatArray:
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def _box_corners(lower_m: FloatArray, upper_m: FloatArray) -> FloatArray:
    pick = np.array([[(n >> axis) & 1 for axis in range(3)] for n in range(8)])
    corners: FloatArray = np.where(pick == 1, upper_m, lower_m)
    return corners


def _with_apron(lower_m: FloatArray, upper_m: FloatArray) -> FloatArray:
    """Return the corners of the box and of the floor strip around it that holds the ruler."""
    strip = 0.075 * float((np.asarray(upper_m) - lower_m)[:2].max()) * np.array([1.0, 1.0, 0.0])
    floor = np.array([upper_m[0], upper_m[1], lower_m[2]])
    return np.concatenate([_box_corners(lower_m, upper_m), _box_corners(lower_m - strip, floor + strip)])


def _centred(view: RenderView, points: FloatArray, fill: float) -> RenderView:
    """Return the view, scaled and shifted so that the points fill the image."""
    screen = view.project(points)[:, :2]
    low, high = screen.min(axis=0), screen.max(axis=0)
    zoom = fill * float((np.array([view.width, view.height]) / (high - low)).min())
    middle = (np.array([view.width, view.height]) / 2) - zoom * ((low + high) / 2 - view.centre_px)
    return RenderView(
        view.camera_from_world,
        view.eye_world_m,
        view.scale_px * zoom,
        (float(middle[0]), float(middle[1])),
        view.width,
        view.height,
        view.orthographic,
    )


def _vertex_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return area-weighted unit normals (V, 3)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    total = np.stack(
        [np.bincount(faces.ravel(), np.repeat(normal[:, axis], 3), minlength=len(vertices)) for axis in range(3)], axis=1
    )
    unit: FloatArray = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)
    return unit


def _shade(normals: FloatArray, view: RenderView) -> FloatArray:
    """Return the light (V,) in linear units.

    Sky light from above, a key light over the viewer's left shoulder, and a weak fill light.
    """
    key = np.array([-0.45, -0.75, -0.6]) @ view.camera_from_world
    key /= np.linalg.norm(key)
    fill = np.array([0.8, -0.1, -0.5]) @ view.camera_from_world
    fill /= np.linalg.norm(fill)
    light: FloatArray = (
        0.64 + 0.14 * normals[:, 2] + 0.40 * np.clip(normals @ key, 0, None) + 0.18 * np.clip(normals @ fill, 0, None)
    )
    return light


def _creases(depth: FloatArray, view: RenderView) -> FloatArray:
    """Return eye-dome lighting factors (H, W): nearer neighbours darken a pixel (Boucheny 2009)."""
    filled = np.where(np.isfinite(depth), depth, np.nan)
    metres_per_px = (1.0 if view.orthographic else float(np.nanmedian(filled)) if np.isfinite(depth).any() else 1.0) / (
        view.scale_px * _OVERSAMPLING
    )
    total = np.zeros_like(depth)
    for radius in (2, 6, 14):
        for du, dv in ((radius, 0), (-radius, 0), (0, radius), (0, -radius)):
            neighbour = np.roll(filled, (dv, du), axis=(0, 1))
            # slopes have a small weight, steps and inner corners a large one
            slope = (filled - neighbour) / (radius * metres_per_px)
            total += np.clip(np.nan_to_num(slope) - 0.5, 0.0, 4.0) / 4.0
    factors: FloatArray = np.exp(-_CREASE_STRENGTH * total)
    return factors


@kernel
def _rasterise(
    screen: FloatArray, faces: IntArray, colour: FloatArray, height: int, width: int, orthographic: bool
) -> tuple[FloatArray, FloatArray]:
    """Render into a z-buffer: colours (H, W, 3) and depth (H, W), infinite where empty.

    Pixel (0, 0) is centred at (0.5, 0.5).
    """
    image = np.zeros((height, width, 3), dtype=np.float64)
    depth = np.full((height, width), np.inf, dtype=np.float64)
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay, az = screen[a, 0], screen[a, 1], screen[a, 2]
        bx, by, bz = screen[b, 0], screen[b, 1], screen[b, 2]
        cx, cy, cz = screen[c, 0], screen[c, 1], screen[c, 2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        # v points down: front faces are clockwise on the screen, which is a negative area here
        if not (area < 0.0) or az < 0.05 or bz < 0.05 or cz < 0.05:
            continue
        left, right = max(int(min(ax, bx, cx)), 0), min(int(max(ax, bx, cx)) + 1, width)
        top, bottom = max(int(min(ay, by, cy)), 0), min(int(max(ay, by, cy)) + 1, height)
        for row in range(top, bottom):
            for column in range(left, right):
                u, v = column + 0.5, row + 0.5
                wa = ((bx - u) * (cy - v) - (by - v) * (cx - u)) / area
                wb = ((cx - u) * (ay - v) - (cy - v) * (ax - u)) / area
                wc = 1.0 - wa - wb
                if wa < 0.0 or wb < 0.0 or wc < 0.0:
                    continue
                if not orthographic:  # 1/z varies linearly over the screen
                    wa, wb, wc = wa / az, wb / bz, wc / cz
                    total = wa + wb + wc
                    wa, wb, wc = wa / total, wb / total, wc / total
                z = wa * az + wb * bz + wc * cz
                if z < depth[row, column]:
                    depth[row, column] = z
                    for k in range(3):
                        image[row, column, k] = wa * colour[a, k] + wb * colour[b, k] + wc * colour[c, k]
    return image, depth
