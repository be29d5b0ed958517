"""Learn a surface from colour and depth keyframes with known poses, and write a mesh.

The mesh is coloured. The keyframes come from a synthetic room with striped walls.
"""

import sys

import numpy as np
import trimesh

from uav_recon import Camera, NeuralMapper, Pose, warm_up
from uav_recon.types.camera import Intrinsics
from uav_recon.types.frames import ByteArray, FloatArray

ROOM_MIN_M = np.zeros(3)
ROOM_MAX_M = np.array([4.0, 3.0, 2.5])


def cast(lens: Intrinsics, world_from_camera: Pose) -> tuple[FloatArray, FloatArray]:
    """Return the depth (H, W) along the optical axis, and the surface points (H, W, 3).

    The points are where the pixels' rays meet the room.
    """
    rays, origin = lens.bearings() @ world_from_camera.rotation().T, world_from_camera.translation_m
    depth_m = np.maximum((ROOM_MIN_M - origin) / rays, (ROOM_MAX_M - origin) / rays).min(axis=-1)
    return depth_m, origin + rays * depth_m[..., None]


def render(camera: Camera, world_from_camera: Pose) -> tuple[FloatArray, ByteArray]:
    """Return the depth image (H, W) in metres and the colour image (h, w, 3) uint8 of the room."""
    depth_m, _ = cast(camera.depth, world_from_camera)
    _, points = cast(camera.rgb, world_from_camera @ camera.rgb_from_depth.inverse())
    stripes = np.sin(points * np.pi / 0.5) > 0.0
    return depth_m, np.where(stripes, 220, 90).astype(np.uint8)


def main(out: str = "room.ply") -> None:
    """Learn from twelve views around the room's middle."""
    warm_up()
    camera = Camera.d435i(pitch_down_rad=0.0)  # level: it sees floor and ceiling
    mapper = NeuralMapper.for_box(ROOM_MIN_M, ROOM_MAX_M, camera)
    for yaw_rad in np.arange(12) * np.pi / 6:
        body = Pose.from_yaw(yaw_rad, np.array([2.0, 1.5, 1.2]) - 0.8 * np.array([np.cos(yaw_rad), np.sin(yaw_rad), 0.0]))
        world_from_camera = camera.world_from_camera(body)
        mapper.add(camera.keyframe(*render(camera, world_from_camera), world_from_camera))
        mapper.train(20)
    mapper.polish(100)

    mesh = mapper.mesh(voxel_m=0.04)
    outside_m = np.maximum(ROOM_MIN_M - mesh.vertices_world, mesh.vertices_world - ROOM_MAX_M).max(axis=1)
    print(f"{mapper.views} views, {mapper.steps} training steps, {len(mesh.faces)} triangles")
    print(f"median distance to the walls: {np.median(np.abs(outside_m)) * 100:.1f} cm")
    trimesh.Trimesh(mesh.vertices_world, mesh.faces, vertex_colors=mesh.rgb, process=False).export(out)
    print(f"wrote {out}")


if __name__ == "__main__":
    main(*sys.argv[1:])
