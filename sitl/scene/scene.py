"""Scene of a flight: a vertex-coloured triangle mesh in world coordinates, checked on load."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sitl.geometry.point_grid import PointGrid
from sitl.scene.builtin_room import ROOM_START, built_in_room
from sitl.scene.mesh import Mesh, MeshError, read_mesh
from sitl.scene.mesh_sampling import dense_points, height_below, row_points
from sitl.scene.rasterizer import Renderer
from sitl.scene.scene_kinds import KINDS
from uav_recon.sensors.stream_format import CameraSpec

HULL_RADIUS_M = 0.20
HULL_HEIGHT_M = 0.20
BODY_ABOVE_FLOOR_M = 0.5 * HULL_HEIGHT_M  # the hull stands on the floor
START_MARGIN_M = 0.15
TAKEOFF_HEIGHT_M = 1.10
PAD_TOP_M = 0.40  # below this height above the floor the hull's radius must be free, without a margin
OPEN_SHARE = 0.005
MAX_EXTENT_M = 100.0
MAX_YAW_DEG = 360.0
MAX_REACH_M = 500.0  # of the fence, from the start: the range of coordinates in the product's config
MAX_M3 = 30_000.0  # volume: 30 million voxels of 0.1 m, the limit of the product's map
MAX_M2 = 12_000.0  # surface area, which is sampled every 1 to 2 cm
SAMPLES_M = 0.01
GENERATED = ", ".join(f"{name}:{kind.number}" for name, kind in KINDS.items())  # names of generated scenes

Numbers = tuple[float, ...]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
U8 = NDArray[np.uint8]


class SceneError(Exception):
    """The scene cannot be used for a flight; the message is one line that names the cause."""


@dataclass(frozen=True)
class Scene:
    """A checked scene in the world frame: ENU, m.

    The origin is the body centre of the vehicle standing at the start.
    vertices (V, 3) float32, faces (F, 3) int32, rgb (V, 3) uint8.
    fence_min and fence_max (3,), m.
    scene_from_world_m (3,): added to a world point to get the coordinates of the file.
    paint: the same surface as a fine textured mesh for the colour camera, if faces are coarse.
    """

    name: str
    vertices: F32
    faces: I32
    rgb: U8
    start_yaw_rad: float
    fence_min: F64
    fence_max: F64
    scene_from_world_m: F64
    paint: Mesh | None = None

    @cached_property
    def samples(self) -> PointGrid:
        """Samples of the surface 1 cm apart, computed once (below 1 s for 700k faces)."""
        return PointGrid(row_points(self.vertices, self.faces, SAMPLES_M))


def load_scene(
    path: str | Path | None,
    start: Numbers | None = None,
    fence: Numbers | None = None,
    radius_m: float = HULL_RADIUS_M,
    fine: bool = True,
) -> Scene:
    """Load a scene, move the start to the origin and check it. Blocks for 1 to 2 s.

    path: None for the built-in room, the name of a generated scene as random:SEED (see scene_kinds), a folder with scene.json,
        or a mesh file (z up, metres).
    start: X, Y, Z (m) and YAW (degrees) in the frame of the file.
    fence: lowest X, Y, Z and highest X, Y, Z in the same frame; needed only if the mesh is open.
    radius_m: radius of the hull.
    fine: with texture, for built-in and generated rooms.
    Raises SceneError with one line naming the cause.
    """
    known_start: Numbers | None
    if path is None:
        name, mesh, known_start = "built-in", built_in_room(fine), ROOM_START
    elif is_generated(path):
        name, mesh, known_start = _generated(str(path), fine)
    else:
        name, mesh, known_start = _read(Path(path))
    chosen = start if start is not None else known_start
    if chosen is None:
        raise SceneError(f"{name}: no start given (--start X,Y,Z,YAW in the scene's own frame)")
    return scene_from_mesh(name, mesh, chosen, fence, radius_m)


def free_height_m(scene: Scene, radius_m: float) -> float:
    """Return the height (m, in the world) to which the column above the pad is free.

    An operator at the pad sees it. radius_m: of the column. Below the take-off height it was checked on load.
    """
    corners = scene.vertices[scene.faces]
    touched = (corners[..., :2].min(axis=1) <= radius_m).all(axis=1) & (corners[..., :2].max(axis=1) >= -radius_m).all(axis=1)
    vertices = scene.vertices.copy()  # a kernel of its own would be compiled for the read-only array
    points = dense_points(vertices, scene.faces[touched], 0.01) if touched.any() else np.zeros((0, 3), np.float32)
    above = (np.linalg.norm(points[:, :2], axis=1) < radius_m) & (points[:, 2] > TAKEOFF_HEIGHT_M)
    return float(points[above, 2].min(initial=float(scene.fence_max[2])))


def is_generated(path: str | Path) -> bool:
    """Return True for the name of a generated scene, whose seed may be wrong."""
    return str(path).partition(":")[0] in KINDS and ":" in str(path)


def require_scene(path: str | Path | None) -> None:
    """Check that something can be loaded from a path. Raises SceneError."""
    if path is None or is_generated(path):
        return
    try:
        there = Path(path).exists()
    except OSError as error:
        raise SceneError(f"{path}: cannot be read ({error.strerror})") from None
    if not there:
        raise SceneError(f"{path}: no such scene; want a folder with scene.json, a mesh file, {GENERATED}")


def scene_from_mesh(name: str, mesh: Mesh, start: Numbers, fence: Numbers | None, radius_m: float = HULL_RADIUS_M) -> Scene:
    """Check a mesh and move the start to the origin. Raises SceneError.

    Arguments as for load_scene().
    """
    _check_mesh(name, mesh)
    low, high = mesh.vertices.min(axis=0).astype(np.float64), mesh.vertices.max(axis=0).astype(np.float64)
    point = _numbers(name, "start X,Y,Z,YAW", start, 4)
    if not ((point[:3] >= low) & (point[:3] <= high)).all():
        raise SceneError(f"{name}: start {_text(point[:3])} is outside the scene's bounds {_text(low)} to {_text(high)}")
    if not abs(point[3]) <= MAX_YAW_DEG:
        raise SceneError(f"{name}: start yaw {point[3]:g}: want -{MAX_YAW_DEG:g} to {MAX_YAW_DEG:g} degrees")
    floor_z = height_below(mesh.vertices, mesh.faces, point[:3] + np.array([0.0, 0.0, 0.05]))
    if floor_z is None:
        raise SceneError(f"{name}: no floor below the start {_text(point[:3])}")
    scene_from_world_m = np.array([point[0], point[1], floor_z + BODY_ABOVE_FLOOR_M])
    vertices = np.ascontiguousarray(mesh.vertices - scene_from_world_m, np.float32)
    _check_column(name, vertices, mesh.faces, radius_m)
    fence_min, fence_max = low, high
    if fence is not None:
        bounds = _numbers(name, "fence of 6 numbers", fence, 6)
        fence_min, fence_max = bounds[:3], bounds[3:]
        if not ((fence_min < scene_from_world_m) & (scene_from_world_m < fence_max)).all():
            inside = f"{_text(fence_min)} to {_text(fence_max)}"
            raise SceneError(f"{name}: the start {_text(scene_from_world_m)} lies outside the fence {inside}")
        reach_m = float(np.abs(bounds - np.tile(scene_from_world_m, 2)).max())
        if reach_m > MAX_REACH_M:
            raise SceneError(f"{name}: the fence reaches {reach_m:.0f} m from the start; want at most {MAX_REACH_M:.0f} m")
        _check_size(name, "fence", fence_max - fence_min)
    else:
        _check_closed(name, Renderer(vertices, mesh.faces, mesh.rgb))
    arrays = (
        vertices,
        mesh.faces,
        mesh.rgb,
        fence_min - scene_from_world_m,
        fence_max - scene_from_world_m,
        scene_from_world_m,
    )
    for array in arrays:
        array.setflags(write=False)
    yaw_rad = math.radians(float(point[3]))
    return Scene(name, vertices, mesh.faces, mesh.rgb, yaw_rad, arrays[3], arrays[4], scene_from_world_m)


def _numbers(name: str, what: str, values: Numbers, count: int) -> F64:
    array = np.asarray(values, np.float64)
    if array.shape != (count,) or not np.isfinite(array).all():
        raise SceneError(f"{name}: want a {what}, got {values}")
    return array


def _text(values: NDArray[Any]) -> str:
    return "(" + ", ".join(f"{float(v):.2f}" for v in values) + ")"


def _generated(path: str, fine: bool) -> tuple[str, Mesh, Numbers]:
    name, _, words = path.partition(":")
    kind = KINDS[name]
    if not words.isdecimal() or not kind.allows(int(words)):
        raise SceneError(f"{path}: want {name}:{kind.number} with a whole number, {kind.range}")
    mesh, start = kind.draw(int(words), fine)
    return f"{name}-{int(words)}", mesh, start


def _read(path: Path) -> tuple[str, Mesh, Numbers | None]:
    require_scene(path)
    start: Numbers | None = None
    name, file = path.stem, path
    if path.is_dir():
        description = path / "scene.json"
        try:
            entry = json.loads(description.read_text())
            name, file = str(entry["name"]), path / str(entry["file"])
            if "start" in entry:
                s = entry["start"]
                start = (float(s["x"]), float(s["y"]), float(s["z"]), math.degrees(float(s["yaw"])))
        except OSError as error:
            raise SceneError(f"{description}: cannot be read ({error.strerror})") from None
        except RecursionError:
            raise SceneError(f"{description}: not a scene description (nested too deeply)") from None
        except ValueError as error:
            raise SceneError(f"{description}: not a scene description ({error})") from None
        except OverflowError:
            raise SceneError(f"{description}: not a scene description (a number of start is too large)") from None
        except (KeyError, TypeError):
            raise SceneError(
                f"{description}: not a scene description (want name, file and a start with x, y, z, yaw)"
            ) from None
    try:
        return name, read_mesh(file), start
    except MeshError as error:
        raise SceneError(str(error)) from None


def _check_mesh(name: str, mesh: Mesh) -> None:
    if not len(mesh.faces) or not len(mesh.vertices):
        raise SceneError(f"{name}: the mesh is empty")
    if not np.isfinite(mesh.vertices).all():
        raise SceneError(f"{name}: {int((~np.isfinite(mesh.vertices)).any(axis=1).sum())} vertices are not finite")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise SceneError(f"{name}: a face names vertex {mesh.faces.max()} of {len(mesh.vertices)}")
    extent = np.ptp(mesh.vertices, axis=0)
    if extent.max() > MAX_EXTENT_M:
        raise SceneError(f"{name}: {extent.max():.0f} m across; more than {MAX_EXTENT_M:.0f} m (is the file in metres?)")
    _check_size(name, "scene", extent)
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    area_m2 = 0.5 * float(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum())
    if area_m2 > MAX_M2:
        raise SceneError(f"{name}: a surface of {area_m2:.0f} m2; want at most {MAX_M2:.0f} (is the file in metres?)")


def _check_size(name: str, what: str, size_m: F64) -> None:
    """Raise SceneError for a volume above MAX_M3.

    The product's map and the simulator's ground truth keep arrays of this volume.
    """
    volume_m3 = float(np.prod(size_m))
    if volume_m3 > MAX_M3:
        raise SceneError(f"{name}: a {what} of {_text(size_m)} m holds {volume_m3:.0f} m3; want at most {MAX_M3:.0f}")


def _check_column(name: str, vertices: F32, faces: I32, radius_m: float) -> None:
    """Raise SceneError unless the hull can rise from the floor to the take-off height.

    Above PAD_TOP_M a margin around the hull must be free, too.
    """
    reach = radius_m + START_MARGIN_M
    corners = vertices[faces]
    touched = (corners[..., :2].min(axis=1) <= reach).all(axis=1) & (corners[..., :2].max(axis=1) >= -reach).all(axis=1)
    points = dense_points(vertices, faces[touched], 0.01)
    distance, height = np.linalg.norm(points[:, :2], axis=1), points[:, 2] + BODY_ABOVE_FLOOR_M
    top = TAKEOFF_HEIGHT_M + BODY_ABOVE_FLOOR_M + START_MARGIN_M
    pad = (height > 0.05) & (height <= PAD_TOP_M) & (distance < radius_m)
    above = (height > PAD_TOP_M) & (height < top) & (distance < reach)
    if (pad | above).any():
        nearest = int(np.argmin(np.where(pad | above, distance, np.inf)))
        raise SceneError(
            f"{name}: the start is blocked: an obstacle {distance[nearest]:.2f} m from its axis at height "
            f"{height[nearest]:.2f} m (want {reach:.2f} m up to {top:.2f} m, {radius_m:.2f} m below {PAD_TOP_M:.2f} m)"
        )


def _check_closed(name: str, renderer: Renderer) -> None:
    """Raise SceneError if the mesh is open.

    It is rendered from 1.2 m above the floor at the start in the six directions of a cube; each pixel is weighted by its
    solid angle.
    """
    size = 96
    spec = CameraSpec(size, size, size / 2, size / 2, (size - 1) / 2, (size - 1) / 2)
    grid = (np.arange(size) - spec.cx) / spec.fx
    solid_angle = (1.0 + grid[:, None] ** 2 + grid[None, :] ** 2) ** -1.5
    missed = 0.0
    for axis in range(3):
        for sign in (1.0, -1.0):
            world_from_camera = np.eye(4)
            forward, right = sign * np.eye(3)[axis], np.eye(3)[(axis + 1) % 3]
            world_from_camera[:3, :3] = np.array([right, np.cross(forward, right), forward]).T
            world_from_camera[2, 3] = 1.2 - BODY_ABOVE_FLOOR_M
            depth = renderer.depth(world_from_camera, spec, near_m=0.01)
            missed += float(solid_angle[depth == 0.0].sum())
    share = missed / (6.0 * float(solid_angle.sum()))
    if share > OPEN_SHARE:
        raise SceneError(f"{name}: the scene is open ({share:.1%} of all directions see no surface): give --fence")
