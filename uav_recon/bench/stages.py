"""The planner's stages, driven one by one with a clock between them: fusion to tour, once per recorded frame.

The same objects in the same order as AdaptivePlanner.plan(), which has no clock inside. The drone follows the recorded poses;
nothing that is planned is flown, so that every frame asks for a whole decision.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.bench.laps import Stopwatch
from uav_recon.bench.recording import Recording
from uav_recon.bench.view_oracle import Frontier as Target
from uav_recon.bench.view_oracle import Lens
from uav_recon.config import MotionConfig, PlannerConfig, VoxelConfig
from uav_recon.mapping.voxels import DepthSensor, Voxels
from uav_recon.planning import planner, search, tour
from uav_recon.planning.camera import EDGE_MARGIN, CameraGeometry
from uav_recon.planning.flyable import FlyableSpace, way_out
from uav_recon.planning.frontiers import fence_box, find_frontiers, unknown_faces
from uav_recon.planning.planner import MAX_TOUR_TASKS, nearest
from uav_recon.planning.proposal import Proposal, Situation
from uav_recon.planning.routes import Routes, time_costs
from uav_recon.planning.viewpoints import FrontierViews
from uav_recon.types.camera import Intrinsics, PosedFrame
from uav_recon.types.frames import BoolArray, FloatArray, IntArray
from uav_recon.types.maps import GridSpec, VoxelMap

SENSOR = DepthSensor(depth_min_m=0.1, noise_px=0.03, baseline_m=0.05)  # the recordings are free of noise
WARM_FRAMES = 20
GIMBAL_RAD = np.radians(60.0)
# laps, and the stages of the tables that they add up to
SEARCH, VIEWPOINTS, TOUR = ("space", "frontiers"), ("views",), ("ways", "order")
STAGES: dict[str, tuple[str, ...]] = {
    "fusion": ("fusion",),
    "distance": ("distance",),
    "search": SEARCH,
    "viewpoints": VIEWPOINTS,
    "tour": TOUR,
    "decision": (*SEARCH, *VIEWPOINTS, *TOUR),
    "total": ("fusion", "distance", *SEARCH, *VIEWPOINTS, *TOUR),
}


@dataclass(frozen=True, slots=True, eq=False)
class ChosenView:
    """A view that the planner chose for a frontier: (x, y, z, yaw, pitch down), lengths in voxels."""

    view: FloatArray
    frontier: Target


@dataclass(frozen=True, slots=True, eq=False)
class Decision:
    """What one frame came to. reachable: (nx, ny, nz); None: the vehicle has no known-free way from where it stands."""

    voxels: VoxelMap
    reachable: BoolArray | None
    chosen: tuple[ChosenView, ...]


def camera_of(lens: Intrinsics, range_m: float) -> CameraGeometry:
    """The recording camera as the planner sees it: at the body's centre, on a gimbal."""
    return CameraGeometry(
        hfov_rad=2 * float(np.arctan(lens.width / 2 / lens.fx)),
        vfov_rad=2 * float(np.arctan(lens.height / 2 / lens.fy)),
        position_body_m=np.zeros(3),
        pitch_min_rad=-GIMBAL_RAD,
        pitch_max_rad=GIMBAL_RAD,
        range_m=range_m,
        near_m=SENSOR.depth_min_m,
    )


def oracle_lens(camera: CameraGeometry, resolution_m: float) -> Lens:
    """The same camera for the brute force, with the same margin at the picture's edge."""
    return Lens(
        tan_h=float(np.tan(camera.hfov_rad / 2)) * EDGE_MARGIN,
        tan_v=float(np.tan(camera.vfov_rad / 2)) * EDGE_MARGIN,
        near=camera.near_m / resolution_m,
        reach=camera.range_m / resolution_m,
        pitch_min_rad=camera.pitch_min_rad,
        pitch_max_rad=camera.pitch_max_rad,
    )


class Replay:
    """One flight's map and planner, fed with recorded frames. fence_low_m, fence_high_m: (3,) in world."""

    def __init__(self, recording: Recording, grid: GridSpec, fence_low_m: FloatArray, fence_high_m: FloatArray) -> None:
        self.config, motion = PlannerConfig(), MotionConfig()
        self.camera = camera_of(recording.lens, recording.max_range_m)
        cap_m = VoxelConfig().distance_cap_m
        self.voxels = Voxels(
            grid,
            SENSOR,
            recording.max_range_m,
            tuple(fence_low_m.tolist()),
            tuple(fence_high_m.tolist()),
            cap_m,
            pixel_stride=recording.stride,
        )
        self.fence = fence_box(grid, fence_low_m, fence_high_m)
        inset_m = self.config.clearance_m
        self._body_box = fence_box(grid, fence_low_m + inset_m, fence_high_m - inset_m)
        self._speed_mps, self._yaw_rate_radps = motion.speed_mps, float(np.radians(motion.yaw_rate_degps))
        self._views = FrontierViews(self.config, self.camera)
        self._nothing_exhausted = np.zeros(grid.shape, dtype=np.bool_)

    def start(self, posed: PosedFrame) -> None:
        """The operator's word, as before any take-off: the cylinder over the pad is free."""
        place = posed.world_from_depth.translation_m
        self.voxels.declare_free(place, VoxelConfig().takeoff_radius_m, 0.0, float(place[2]) + 0.3)

    def settle(self, posed: PosedFrame) -> None:
        """Plan once from a pose, unmeasured: what lies in the map already is known to the planner from now on."""
        self.decide(posed, Stopwatch())

    def decide(self, posed: PosedFrame, watch: Stopwatch) -> Decision:
        """Fuse a frame and plan from its pose; the laps of ``watch`` are those of STAGES."""
        watch.restart()
        self.voxels.integrate(posed)
        watch.lap("fusion")
        voxels = self.voxels.snapshot()
        watch.lap("distance")
        situation = self._situation(voxels, posed)
        watch.lap("space")
        census = find_frontiers(unknown_faces(voxels.state, *self.fence), self._nothing_exhausted, voxels.grid.resolution_m)
        watch.lap("frontiers")
        if situation is None:
            return Decision(voxels, None, ())
        found = self._views.propose(situation, census.frontiers)
        watch.lap("views")
        self._tour(situation, posed, nearest(situation, found.proposals, MAX_TOUR_TASKS), watch)
        reachable = situation.reachable[1:-1, 1:-1, 1:-1] > 0
        return Decision(voxels, reachable, tuple(self._chosen(voxels, proposal) for proposal in found.proposals))

    def _situation(self, voxels: VoxelMap, posed: PosedFrame) -> Situation | None:
        place = posed.world_from_depth.translation_m
        space = FlyableSpace.of(voxels, self.config.clearance_m, *self._body_box)
        exit_cells = way_out(space, place)
        if exit_cells is None:
            return None
        reach, previous = search.distances_from(space.mask, int(exit_cells[-1]), np.zeros(0, dtype=np.int64), np.inf)
        reachable = np.where(np.isfinite(reach), space.mask.ravel(), np.uint8(0)).reshape(space.mask.shape)
        return Situation(voxels, space, exit_cells, place, reachable, reach, previous)

    def _tour(self, situation: Situation, posed: PosedFrame, tasks: list[Proposal], watch: Stopwatch) -> IntArray:
        if not tasks:
            return np.zeros(0, dtype=np.int64)
        routes = Routes(situation, situation.position_world, tasks)
        costs = time_costs(routes, tasks, heading_rad(posed), np.zeros(3), self._speed_mps, self._yaw_rate_radps)
        watch.lap("ways")
        order = tour.best_tour(costs)
        watch.lap("order")
        return order

    def _chosen(self, voxels: VoxelMap, proposal: Proposal) -> ChosenView:
        grid, view = voxels.grid, proposal.task.viewpoint
        place = (view.position_world - grid.origin_world_m) / grid.resolution_m
        cells = np.stack(np.unravel_index(proposal.promised, grid.shape), axis=-1)
        return ChosenView(np.array([*place, view.yaw_rad, view.pitch_down_rad]), Target(cells, *self.fence))


def heading_rad(posed: PosedFrame) -> float:
    """Where the optical axis points, seen from above."""
    axis = posed.world_from_depth.rotation()[:, 2]
    return float(np.arctan2(axis[1], axis[0]))


def warm_up(recording: Recording) -> None:
    """Compile every kernel that a replay runs, on a flight of its own over the first frames."""
    planner.warm_up()
    replay = Replay(recording, recording.grid, recording.low_m, recording.high_m)
    replay.voxels.warm_up()
    replay.start(recording.frames[0])
    for posed in recording.frames[:WARM_FRAMES]:
        replay.decide(posed, Stopwatch())
