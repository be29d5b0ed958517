"""Explore a synthetic room: map, plan the next views, repeat; draw the path and the views."""

import sys

import numpy as np
from matplotlib.figure import Figure

from uav_recon import Camera, NothingLeft, OccupancyMapper, Pose, ViewPlanner, warm_up
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import OCCUPIED

ROOM_MIN_M = np.zeros(3)
ROOM_MAX_M = np.array([6.0, 4.0, 2.5])
WALL_MIN_M = np.array([3.0, 0.0, 0.0])  # hides the other half of the room
WALL_MAX_M = np.array([3.2, 2.4, 2.5])


def render(camera: Camera, world_from_camera: Pose) -> FloatArray:
    """Return the depth image (H, W) of a room with a wall in it, in metres."""
    rays, origin = camera.depth.bearings() @ world_from_camera.rotation().T, world_from_camera.translation_m
    room_m = np.maximum((ROOM_MIN_M - origin) / rays, (ROOM_MAX_M - origin) / rays).min(axis=-1)
    faces_m = np.stack([(WALL_MIN_M - origin) / rays, (WALL_MAX_M - origin) / rays])
    enter_m, leave_m = faces_m.min(axis=0).max(axis=-1), faces_m.max(axis=0).min(axis=-1)
    depth_m: FloatArray = np.where((enter_m > 0.0) & (enter_m < leave_m), enter_m, room_m)
    return depth_m


def main(out: str = "views.png") -> None:
    """Explore until no view is worth a flight."""
    warm_up()
    camera = Camera.d435i()
    mapper = OccupancyMapper(camera, ROOM_MIN_M, ROOM_MAX_M)
    planner = ViewPlanner.for_box(ROOM_MIN_M, ROOM_MAX_M, camera)
    bodies = [Pose.from_yaw(yaw_rad, np.array([1.2, 1.2, 1.2])) for yaw_rad in np.arange(8) * np.pi / 4]
    mapper.declare_free(bodies[0].translation_m)  # the body stands there
    seen, flown = 0, [bodies[0].translation_m[None]]
    while True:
        for body in bodies[seen:]:
            mapper.add_depth(render(camera, camera.world_from_camera(body)), camera.world_from_camera(body))
        seen = len(bodies)
        path = planner.plan_views(mapper.map, bodies[-1], views=10)
        print(f"{seen} views, {mapper.explored_m3:.1f} of {np.prod(ROOM_MAX_M):.1f} m3 known")
        if isinstance(path, NothingLeft):
            print(path.reason.text())
            break
        planner.accept(path)
        flown += path.waypoints_world
        bodies += [Pose.from_yaw(view.yaw_rad, view.position_world) for view in path.viewpoints]

    figure = Figure(figsize=(8, 6))
    axes = figure.add_subplot(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    walls = mapper.points(OCCUPIED)
    axes.plot(*walls[np.abs(walls[:, 2] - 1.2) < 0.1][:, :2].T, "s", color="0.6", markersize=4)
    axes.plot(*np.concatenate(flown)[:, :2].T, linewidth=0.8)
    views = np.array([[*body.translation_m[:2], np.cos(body.yaw_rad()), np.sin(body.yaw_rad())] for body in bodies])
    axes.quiver(*views.T, np.arange(len(views)), scale=30.0, width=0.004)
    figure.savefig(out)
    print(f"wrote {out}")


if __name__ == "__main__":
    main(*sys.argv[1:])
