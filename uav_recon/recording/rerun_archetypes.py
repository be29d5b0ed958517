"""Conversion of the product's values to rerun archetypes.

Each function returns (entity, archetype) pairs and keeps no state.
"""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np

from uav_recon.recording import blueprint as names
from uav_recon.recording.software_renderer import facing_inwards
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame
from uav_recon.types.frames import ByteArray, FloatArray
from uav_recon.types.maps import FREE, OCCUPIED, SurfaceElements, TriangleMesh, VoxelMap
from uav_recon.types.pose import Pose
from uav_recon.types.tasks import ViewPath, Viewpoint
from uav_recon.types.trajectory import Trajectory

Drawing = list[tuple[str, Any]]

_JPEG_QUALITY = 75
_MAX_POINTS = 20_000
_IMAGE_PLANE_M = 0.25
_GREEN = (22, 163, 74)
_ORANGE = (234, 115, 23)
_BLUE = (37, 99, 235)
_GREY = (123, 135, 148)


def scene(fence_world_m: FloatArray) -> Drawing:
    """Return axes and fence; logged once."""
    import rerun as rr

    lower, upper = fence_world_m
    fence = rr.Boxes3D(
        centers=[(lower + upper) / 2],
        half_sizes=[(upper - lower) / 2],
        colors=[_GREY],
        radii=[0.005],
        fill_mode="MajorWireframe",
    )
    return [(names.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP), (names.FENCE, fence)]


def body(world_from_body: Pose, radius_m: float = 0.2) -> Drawing:
    """Return the vehicle as an arrow in its forward direction."""
    import rerun as rr

    arrow = rr.Arrows3D(origins=[[0, 0, 0]], vectors=[[2 * radius_m, 0, 0]], colors=[_BLUE], radii=[0.03])
    return [(names.BODY, _transform(world_from_body)), (names.BODY, arrow)]


def trail(strip: int, points_world: FloatArray) -> Drawing:
    """Return one strip of the flown path.

    The path consists of many strips, so that long ones are not written repeatedly.
    """
    import rerun as rr

    return [(f"{names.TRAIL}/{strip:04d}", rr.LineStrips3D([points_world.astype(np.float32)], colors=[_BLUE], radii=[0.012]))]


def frame(posed: PosedFrame) -> Drawing:
    """Return colour as JPEG and depth as a 16 bit PNG in millimetres, each with its pinhole."""
    import rerun as rr

    now = posed.frame
    world_from_rgb = posed.world_from_depth @ now.rgb_from_depth.inverse()
    return [
        (names.DEPTH, _transform(posed.world_from_depth)),
        (names.DEPTH, _pinhole(now.depth_intrinsics, _IMAGE_PLANE_M)),
        (f"{names.DEPTH}/image", rr.EncodedDepthImage(blob=depth_png(now), media_type="image/png")),
        (names.RGB, _transform(world_from_rgb)),
        (names.RGB, _pinhole(now.rgb_intrinsics, 2 * _IMAGE_PLANE_M)),
        (f"{names.RGB}/image", rr.EncodedImage(contents=rgb_jpeg(now.rgb), media_type="image/jpeg")),
    ]


def depth_png(now: Frame) -> bytes:
    """Return depth in whole millimetres, 0 without a return or beyond the range of 16 bits."""
    import cv2

    millimetres = np.nan_to_num(now.depth_m, nan=0.0, posinf=0.0, neginf=0.0) * 1000.0
    millimetres[(millimetres < 0) | (millimetres > 65535)] = 0.0
    _, data = cv2.imencode(".png", np.round(millimetres).astype(np.uint16), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return bytes(data)


def rgb_jpeg(rgb: ByteArray) -> bytes:
    """Return colour as JPEG."""
    import cv2

    _, data = cv2.imencode(".jpg", np.ascontiguousarray(rgb[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return bytes(data)


def voxels(now: VoxelMap) -> Drawing:
    """Return the occupied voxels as points coloured by height; other voxels are not drawn.

    The ceiling is a separate entity, so that a view can leave it out: all occupied voxels above nine tenths of the free
    voxels.
    """
    import rerun as rr

    layers = np.cumsum((now.state == FREE).sum(axis=(0, 1)))
    below_ceiling = int(np.searchsorted(layers, 0.9 * layers[-1])) + 1 if layers[-1] else now.grid.shape[2]
    index = np.argwhere(now.state == OCCUPIED)
    drawn: Drawing = []
    for entity, part in ((names.VOXELS, index[:, 2] < below_ceiling), (names.CEILING, index[:, 2] >= below_ceiling)):
        shown = _thinned(index[part])
        colours = _colours(shown[:, 2] / max(now.grid.shape[2] - 1, 1), "viridis")
        points = now.grid.centre(shown).astype(np.float32)
        drawn.append((entity, rr.Points3D(points, colors=colours, radii=[0.25 * now.grid.resolution_m])))
    return drawn


def surface(now: SurfaceElements) -> Drawing:
    """Return the surface elements, coloured by uncertainty from blue (low) to red."""
    import rerun as rr

    pick = _thinned(np.arange(len(now.uncertainty)))
    uncertainty = now.uncertainty[pick]
    low, high = np.percentile(uncertainty, [2.0, 98.0]) if len(uncertainty) else (0.0, 1.0)
    colours = _colours((uncertainty - low) / max(float(high - low), 1e-9), "turbo")
    return [(names.SURFACE, rr.Points3D(now.position_world[pick].astype(np.float32), colors=colours, radii=[0.018]))]


def plan(now: ViewPath) -> Drawing:
    """Return the path to each view, and the views as arrows."""
    import rerun as rr

    strips = [np.asarray(waypoints, dtype=np.float32) for waypoints in now.waypoints_world if len(waypoints) > 1]
    origins = np.array([view.position_world for view in now.viewpoints]).reshape(-1, 3)
    vectors = np.array([0.3 * _looking(view) for view in now.viewpoints]).reshape(-1, 3)
    return [
        (names.PLAN, rr.LineStrips3D(strips, colors=[_ORANGE], radii=[0.01])),
        (f"{names.PLAN}/views", rr.Arrows3D(origins=origins, vectors=vectors, colors=[_ORANGE], radii=[0.012])),
    ]


def trajectory(now: Trajectory | None) -> Drawing:
    """Return the proposed trajectory."""
    import rerun as rr

    strips = [] if now is None or len(now.position_m) < 2 else [now.position_m[::3].astype(np.float32)]
    return [(names.TRAJECTORY, rr.LineStrips3D(strips, colors=[_GREEN], radii=[0.008]))]


def mesh(now: TriangleMesh, inside_world: FloatArray | None) -> Drawing:
    """Return the finished model, and commands that clear voxels and elements.

    inside_world (3,): a free point, if known; then only the sides of the surface that face the room are drawn, if the viewer
    supports it.
    """
    import rerun as rr

    one_sided = inside_world is not None and "face_rendering" in inspect.signature(rr.Mesh3D.__init__).parameters
    faces = now.faces if inside_world is None else facing_inwards(now.vertices_world, now.faces, inside_world)
    drawn = rr.Mesh3D(
        vertex_positions=now.vertices_world.astype(np.float32),
        triangle_indices=faces.astype(np.uint32),
        vertex_colors=now.rgb,
        **({"face_rendering": "Front"} if one_sided else {}),  # not in older viewers
    )
    cleared = [(entity, rr.Clear(recursive=True)) for entity in (names.VOXELS, names.CEILING, names.SURFACE)]
    return [*cleared, (names.MESH, drawn)]


def _transform(target_from_source: Pose) -> Any:
    import rerun as rr

    w, x, y, z = target_from_source.quat_wxyz
    return rr.Transform3D(translation=target_from_source.translation_m, quaternion=rr.Quaternion(xyzw=[x, y, z, w]))


def _pinhole(camera: Intrinsics, image_plane_m: float) -> Any:
    import rerun as rr

    return rr.Pinhole(
        focal_length=[camera.fx, camera.fy],
        principal_point=[camera.cx + 0.5, camera.cy + 0.5],  # in rerun, pixel (0, 0) starts at its corner
        resolution=[camera.width, camera.height],
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=image_plane_m,
    )


def _looking(view: Viewpoint) -> FloatArray:
    level = np.cos(view.pitch_down_rad)
    return np.array([level * np.cos(view.yaw_rad), level * np.sin(view.yaw_rad), -np.sin(view.pitch_down_rad)])


def _thinned(rows: Any) -> Any:
    """Return at most _MAX_POINTS rows, evenly selected."""
    return rows[:: -(-len(rows) // _MAX_POINTS)] if len(rows) > _MAX_POINTS else rows


def _colours(share: FloatArray, colour_map: str) -> ByteArray:
    import matplotlib

    return np.asarray(matplotlib.colormaps[colour_map](np.clip(share, 0.0, 1.0))[:, :3] * 255.0, dtype=np.uint8)
