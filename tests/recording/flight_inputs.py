"""Small synthetic inputs: a flight through a box-shaped room."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uav_recon.recording.flight_log import FlightLog
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame, body_from_camera
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import FREE, OCCUPIED, GridSpec, SurfaceElements, TriangleMesh, VoxelMap
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.tasks import PlanMode, ViewPath, Viewpoint
from uav_recon.types.vehicle import FlightPhase, MissionProgress, VehicleState

START_S = 1000.0
INSIDE = np.array([1.0, 0.5, 1.2])


def position(t_s: float) -> FloatArray:
    """Return a position on a circle of 0.8 m radius, flown at about 0.4 m/s."""
    return np.array([1.0 + 0.8 * np.cos(t_s / 2), 0.5 + 0.8 * np.sin(t_s / 2), 1.2])


def odometry(t_s: float) -> StampedPose:
    pose = Pose.from_yaw(t_s / 2 + np.pi / 2, position(t_s))
    return StampedPose(START_S + t_s, pose, np.array([-0.4 * np.sin(t_s / 2), 0.4 * np.cos(t_s / 2), 0.0]))


def frame(t_s: float) -> PosedFrame:
    depth_m = np.full((24, 42), 2.0, dtype=np.float32)
    depth_m[:, :5] = np.nan
    rgb = np.zeros((30, 40, 3), dtype=np.uint8)
    rgb[..., 0] = 200
    taken = Frame(
        stamp_s=START_S + t_s,
        sequence=int(10 * t_s),
        depth_m=depth_m,
        depth_intrinsics=Intrinsics.from_fov(42, 24, 1.5, 1.0),
        rgb=rgb,
        rgb_intrinsics=Intrinsics.from_fov(40, 30, 1.2, 0.73),
        rgb_from_depth=Pose(np.array([1.0, 0, 0, 0]), np.array([-0.015, 0, 0])),
    )
    body_from_depth = body_from_camera(np.array([0.1, 0.0, 0.0]), np.radians(15.0))
    return PosedFrame(taken, odometry(t_s).odom_from_body @ body_from_depth)


def voxel_map() -> VoxelMap:
    """Return a map that is free inside [-1, 3] x [-1, 2] x [0, 2.4].

    A shell of occupied voxels surrounds it; beyond that, all is unknown.
    """
    grid = GridSpec.covering(np.array([-1.3, -1.3, -0.3]), np.array([3.3, 2.3, 2.7]), 0.1)
    centres = grid.centre(np.stack(np.meshgrid(*[np.arange(n) for n in grid.shape], indexing="ij"), axis=-1))
    lower, upper = np.array([-1.0, -1.0, 0.0]), np.array([3.0, 2.0, 2.4])
    state = np.zeros(grid.shape, dtype=np.uint8)
    state[((centres > lower - 0.1) & (centres < upper + 0.1)).all(axis=-1)] = OCCUPIED
    state[((centres > lower) & (centres < upper)).all(axis=-1)] = FREE
    return VoxelMap.whole(grid, state, np.full(grid.shape, 49, dtype=np.uint8), revision=3)


TOO_FAST = Reason(ReasonCode.SPEED_LIMIT, (1.31,))


def surface() -> SurfaceElements:
    rng = np.random.default_rng(0)
    points = rng.uniform([-1, -1, 0], [3, 2, 0], (200, 3))
    return SurfaceElements(points, np.tile([0.0, 0, 1], (200, 1)), rng.random(200), 1)


def view_path() -> ViewPath:
    views = tuple(Viewpoint(position(t), t, 0.26) for t in (1.0, 2.0))
    ways = (np.array([position(0.0), position(1.0)]), np.array([position(1.0), position(2.0)]))
    return ViewPath(views, ways, PlanMode.EXPLORE, 3, 0, (), 0.02, 0.05)


def vehicle(t_s: float, note: Reason | None = None) -> VehicleState:
    return VehicleState(
        START_S + t_s, Pose.identity(), np.zeros(3), True, "OFFBOARD", FlightPhase.FLYING, np.nan, False, np.nan, 1, 0, note
    )


def progress(t_s: float, phase: str = "EXPLORE") -> MissionProgress:
    return MissionProgress(
        stamp_s=START_S + t_s,
        phase=phase,
        mode="explore",
        views=int(t_s),
        views_budget=60,
        explored_m3=20.0 * (1 - np.exp(-t_s / 5)),
        path_length_m=0.4 * t_s,
        frontiers=max(0, 10 - int(t_s)),
        tasks=3,
        plans=int(t_s / 2),
        planning_s=0.05 * t_s,
        note=None,
        finished=False,
        position_world=position(t_s),
        predicted_sigma_m=0.003 + 0.001 * t_s,
        measured_sigma_m=None if t_s < 1.0 else 0.011,
    )


def mesh() -> TriangleMesh:
    """Return the room's walls as subdivided triangles that face outwards, as trimesh makes them."""
    import trimesh

    box = trimesh.creation.box((4.0, 3.0, 2.4))
    for _ in range(4):
        box = box.subdivide()
    vertices = np.asarray(box.vertices) + np.array([1.0, 0.5, 1.2])
    rgb = np.full((len(vertices), 3), 180, dtype=np.uint8)
    rgb[vertices[:, 2] < 1e-6] = (40, 160, 60)
    rgb[vertices[:, 2] > 2.4 - 1e-6] = (200, 20, 20)
    uncertainty = np.linalg.norm(vertices - [3.0, 2.0, 0.0], axis=1).astype(np.float32)
    return TriangleMesh(vertices, np.asarray(box.faces, dtype=np.int64), rgb, uncertainty)


def write_timeline(folder: Path, duration_s: float = 30.0) -> None:
    log = FlightLog(folder)
    for phase, t_s in (("take-off", 0.0), ("survey", 5.0), ("landing", 25.0)):
        log.phase(START_S + t_s, phase, None)
    for t_s in np.arange(0.0, duration_s, 0.5):
        log.progress(progress(float(t_s)))
    for k in range(10):
        log.view(START_S + 2 * k, k, frame(2.0 * k).world_from_depth)
        log.plan(START_S + 2 * k + 1, "explore" if k < 5 else "merged", 0.02, 0.05 + 0.01 * k, 5, 4, 3, 0.0)
    log.plan(START_S + 24, "", 0.01, 0.02, 0, 0, 0, 0.1)
    log.refusal(START_S + 3, TOO_FAST)
    log.close()
