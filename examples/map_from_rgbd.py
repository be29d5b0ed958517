"""Build an occupancy map from depth images with known poses, and draw a slice of it.

The depth images come from a synthetic room. For your own data replace `render` and `poses`.
"""

import sys

import numpy as np
from PIL import Image

from uav_recon import Camera, OccupancyMapper, Pose, warm_up
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import FREE, OCCUPIED

ROOM_MIN_M = np.zeros(3)
ROOM_MAX_M = np.array([5.0, 4.0, 2.5])
CABINET_MIN_M = np.array([3.4, 2.6, 0.0])
CABINET_MAX_M = np.array([4.2, 4.0, 1.6])


def render(camera: Camera, world_from_camera: Pose) -> FloatArray:
    """Return the depth image (H, W) of a room with a cabinet in it, in metres."""
    rays, origin = camera.depth.bearings() @ world_from_camera.rotation().T, world_from_camera.translation_m
    wall_m = np.maximum((ROOM_MIN_M - origin) / rays, (ROOM_MAX_M - origin) / rays).min(axis=-1)
    faces_m = np.stack([(CABINET_MIN_M - origin) / rays, (CABINET_MAX_M - origin) / rays])
    enter_m, leave_m = faces_m.min(axis=0).max(axis=-1), faces_m.max(axis=0).min(axis=-1)
    depth_m: FloatArray = np.where((enter_m > 0.0) & (enter_m < leave_m), enter_m, wall_m)
    return depth_m


def main(out: str = "occupancy.png") -> None:
    """Look around at two positions and map what is seen."""
    warm_up()
    camera = Camera.d435i()
    mapper = OccupancyMapper(camera, ROOM_MIN_M, ROOM_MAX_M, resolution_m=0.1)
    for position_m in ([1.2, 1.2, 1.2], [3.8, 1.2, 1.2]):
        for yaw_rad in np.arange(12) * np.pi / 6:
            world_from_camera = camera.world_from_camera(Pose.from_yaw(yaw_rad, np.array(position_m)))
            mapper.add_depth(render(camera, world_from_camera), world_from_camera)

    voxels = mapper.map
    print(
        f"known: {mapper.explored_m3:.1f} of {np.prod(ROOM_MAX_M):.1f} m3; {len(mapper.points(OCCUPIED))} voxels are occupied"
    )
    height = int(voxels.grid.index(np.array([0.0, 0.0, 1.2]))[2])
    colours = np.array([[128, 128, 128], [255, 255, 255], [0, 0, 0]], dtype=np.uint8)  # of UNKNOWN, FREE, OCCUPIED
    slice_rgb = colours[voxels.state[:, :, height].T[::-1]]
    Image.fromarray(slice_rgb).resize((slice_rgb.shape[1] * 10, slice_rgb.shape[0] * 10), Image.Resampling.NEAREST).save(out)
    print(f"wrote {out}: the map at 1.2 m, {np.mean(voxels.state[:, :, height] == FREE):.0%} free")


if __name__ == "__main__":
    main(*sys.argv[1:])
