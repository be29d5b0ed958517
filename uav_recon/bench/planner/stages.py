"""The stages from a depth frame to a tour, run one by one with lap times, once per frame.

The objects and their order are those of ViewPlanner.plan(), which has no stopwatch; plan() itself is also timed as a whole.
The vehicle follows the recorded poses and never flies a plan, so every frame needs a complete decision.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from uav_recon.bench.planner.recorded_stream import RecordedStream
from uav_recon.bench.planner.view_oracle import OracleFrontier, OracleLens
from uav_recon.config import MotionConfig, PlannerConfig, VoxelConfig
from uav_recon.mapping.occupancy.occupancy_map import DepthSensor, OccupancyMap
from uav_recon.measurement.stage_timing import Stopwatch
from uav_recon.planning import view_planner
from uav_recon.planning.camera_frustum import EDGE_MARGIN, CameraGeometry
from uav_recon.planning.candidate_view import CandidateView
from uav_recon.planning.free_space.flyable_space import FlyableSpace
from uav_recon.planning.frontier.frontier_views import FrontierViews
from uav_recon.planning.frontier.frontiers import Frontiers, fence_box
from uav_recon.planning.paths.path_cache import PathCache
from uav_recon.planning.presets import derived
from uav_recon.planning.task_generation import MAX_FRONTIERS, view_positions
from uav_recon.planning.tour.task_ordering import best_by_rate
from uav_recon.planning.tour.travel_time import YawWhileFlying, time_costs
from uav_recon.planning.variants import variant
from uav_recon.planning.view_headings import suited_to_path
from uav_recon.planning.view_planner import ViewPlanner
from uav_recon.types.camera import Intrinsics, PosedFrame
from uav_recon.types.frames import BoolArray, FloatArray, IntArray
from uav_recon.types.maps import GridSpec, VoxelMap
from uav_recon.types.tasks import PlanRequest

# the only noise of the recordings is their millimetre quantization
SENSOR = DepthSensor(depth_min_m=0.1, noise_px=0.001, baseline_m=0.05)
Mount = Literal["gimbal", "fixed"]
# pitch range of each mount, positive looks down
MOUNTS_RAD: dict[Mount, tuple[float, float]] = {
    "gimbal": (float(np.radians(-60.0)), float(np.radians(60.0))),
    "fixed": (float(np.radians(15.0)), float(np.radians(15.0))),
}
VIEWS_LEFT = 1000
WARM_FRAMES = 20
# laps of a frame, and the stages that are sums of laps
SEARCH = ("frontiers", "space")
VIEWPOINTS = ("views",)
TOUR = ("paths", "order", "headings")
STAGES: dict[str, tuple[str, ...]] = {
    "fusion": ("fusion",),
    "distance": ("distance",),
    "search": SEARCH,
    "viewpoints": VIEWPOINTS,
    "tour": TOUR,
    "decision": (*SEARCH, *VIEWPOINTS, *TOUR),
    "total": ("fusion", "distance", *SEARCH, *VIEWPOINTS, *TOUR),
}
WHOLE: dict[str, tuple[str, ...]] = {
    "fusion": ("fusion",),
    "distance": ("distance",),
    "plan": ("plan",),
    "total": ("fusion", "distance", "plan"),
}


@dataclass(frozen=True, slots=True, eq=False)
class ChosenView:
    """A view that the planner chose for a frontier.

    view: (x, y, z, yaw, pitch down), lengths in voxels.
    """

    view: FloatArray
    frontier: OracleFrontier


@dataclass(frozen=True, slots=True, eq=False)
class BenchDecision:
    """The decision of one frame.

    order: (M,) indices into ``tasks`` of the tour through the tasks that are not deferred. flown: its first views, with
    headings that suit the path.
    """

    voxels: VoxelMap
    tasks: tuple[CandidateView, ...]
    order: IntArray
    flown: tuple[CandidateView, ...] = ()


NOTHING = np.zeros(0, dtype=np.int64)


def camera_of(lens: Intrinsics, range_m: float, mount: Mount = "gimbal") -> CameraGeometry:
    """Return the recording camera for the planner, on a gimbal or with a fixed tilt.

    The camera is at the body's centre.
    """
    low_rad, high_rad = MOUNTS_RAD[mount]
    return CameraGeometry(
        hfov_rad=2 * float(np.arctan(lens.width / 2 / lens.fx)),
        vfov_rad=2 * float(np.arctan(lens.height / 2 / lens.fy)),
        position_body_m=np.zeros(3),
        pitch_min_rad=low_rad,
        pitch_max_rad=high_rad,
        range_m=range_m,
        near_m=SENSOR.depth_min_m,
    )


def oracle_lens(camera: CameraGeometry, resolution_m: float) -> OracleLens:
    """Return the same camera for brute force, with the same margin at the edge of the image."""
    return OracleLens(
        tan_h=float(np.tan(camera.hfov_rad / 2)) * EDGE_MARGIN,
        tan_v=float(np.tan(camera.vfov_rad / 2)) * EDGE_MARGIN,
        near=camera.near_m / resolution_m,
        reach=camera.range_m / resolution_m,
        pitch_min_rad=camera.pitch_min_rad,
        pitch_max_rad=camera.pitch_max_rad,
    )


class ReplayMap:
    """The map of one replay. fence_m: lower and upper corner (3,) in world."""

    def __init__(
        self, recording: RecordedStream, grid: GridSpec, fence_m: tuple[FloatArray, FloatArray], mount: Mount = "gimbal"
    ) -> None:
        self.fence_m = fence_m
        self.fence = fence_box(grid, *fence_m)
        self.camera = camera_of(recording.lens, recording.max_range_m, mount)
        self.config = derived(PlannerConfig(variant="explore"), *fence_m, self.camera)
        low, high = (tuple(corner.tolist()) for corner in fence_m)
        self.voxels = OccupancyMap(
            grid, SENSOR, recording.max_range_m, low, high, VoxelConfig().distance_cap_m, pixel_stride=recording.stride
        )

    def start(self, posed: PosedFrame) -> None:
        """Declare the cylinder over the pad free, as before each take-off."""
        place = posed.world_from_depth.translation_m
        self.voxels.declare_free(place, VoxelConfig().takeoff_radius_m, 0.0, float(place[2]) + 0.3)

    def fuse(self, posed: PosedFrame, watch: Stopwatch) -> VoxelMap:
        """Fuse a frame. Laps: fusion, distance."""
        watch.restart()
        self.voxels.integrate(posed)
        watch.lap("fusion")
        voxels = self.voxels.snapshot()
        watch.lap("distance")
        return voxels

    def planner(self) -> ViewPlanner:
        """Return a planner for this map's fence and camera."""
        motion = MotionConfig()
        travel_time_model = YawWhileFlying(motion.speed_mps, math.radians(motion.yaw_rate_degps))
        return ViewPlanner(self.config, *self.fence_m, self.camera, travel_time_model)


class PlannerStages:
    """The stages of the planner on a map."""

    def __init__(self, mapped: ReplayMap) -> None:
        grid = mapped.voxels.grid
        self._mapped = mapped
        motion = MotionConfig()
        inset_m = mapped.config.clearance_m
        self._space = FlyableSpace(grid, inset_m, *fence_box(grid, mapped.fence_m[0] + inset_m, mapped.fence_m[1] - inset_m))
        self._frontiers = Frontiers()
        self._path_cache = PathCache(self._space)
        self._views = FrontierViews(mapped.config, mapped.camera)
        self._task_ordering = variant(mapped.config.variant, mapped.config).task_ordering
        self._none_ignored = np.zeros(grid.shape, dtype=np.uint8)
        self._travel_time_model = YawWhileFlying(motion.speed_mps, math.radians(motion.yaw_rate_degps))

    def decide(self, voxels: VoxelMap, posed: PosedFrame, watch: Stopwatch) -> BenchDecision:
        """Plan from the pose of a frame. The laps are those of STAGES."""
        place = posed.world_from_depth.translation_m
        watch.restart()
        self._frontiers.update(voxels, *self._mapped.fence, self._none_ignored)
        watch.lap("frontiers")
        self._space.update(voxels)
        exit_cells = self._space.locate_vehicle(place)
        watch.lap("space")
        if exit_cells is None:
            return BenchDecision(voxels, (), NOTHING)
        nearest = self._views.update(voxels, self._space, self._frontiers, place).proposals[:MAX_FRONTIERS]
        gains = self._frontiers.unknown_beyond(voxels, [one.expected_voxels for one in nearest])
        tasks = [one.with_gain(gain) for one, gain in zip(nearest, gains.tolist(), strict=True)]
        watch.lap("views")
        order = self._tour(exit_cells, posed, tasks, watch)
        flown = self._flown(posed, tasks, order)
        watch.lap("headings")
        return BenchDecision(voxels, tuple(tasks), order, flown)

    def reachable(self) -> BoolArray:
        """Return the voxels (nx, ny, nz) reachable at the last decision."""
        mask: BoolArray = self._space.reachable[1:-1, 1:-1, 1:-1] > 0
        return mask

    def _tour(self, exit_cells: IntArray, posed: PosedFrame, tasks: list[CandidateView], watch: Stopwatch) -> IntArray:
        if not tasks:
            return NOTHING
        self._path_cache.update(exit_cells, posed.world_from_depth.translation_m, view_positions(tasks))
        costs_s = time_costs(self._path_cache, tasks, heading_rad(posed), np.zeros(3), self._travel_time_model)
        watch.lap("paths")
        if self._space.is_confined(posed.world_from_depth.translation_m):
            order = np.array([best_by_rate([one.task for one in tasks], costs_s)], dtype=np.int64)
        else:
            order = self._task_ordering.order([one.task for one in tasks], costs_s).order
        watch.lap("order")
        return order - 1

    def _flown(self, posed: PosedFrame, tasks: list[CandidateView], order: IntArray) -> tuple[CandidateView, ...]:
        """Return the views of the tour within the horizon, with headings that suit the path."""
        if not len(order):
            return ()
        nodes = (order + 1).tolist()
        steps = list(zip([0, *nodes[:-1]], nodes, strict=True))
        along_m = np.cumsum([self._path_cache.lengths_m[i, j] for i, j in steps])
        count = max(int(np.searchsorted(along_m, self._mapped.config.horizon_m, side="right")), 1)
        legs = [self._path_cache.path_world(i, j) for i, j in steps[:count]]
        grid, camera = self._mapped.voxels.grid, self._mapped.camera
        lens = camera.lens(grid.resolution_m, camera.range_m)
        views = [tasks[index] for index in order[:count].tolist()]
        return tuple(suited_to_path(views, legs, heading_rad(posed), lens, grid.shape))

    def chosen(self, decision: BenchDecision) -> tuple[ChosenView, ...]:
        """Return the views of the last decision's tasks, each with its frontier."""
        return tuple(self._chosen(decision.voxels.grid, task) for task in decision.tasks)

    def _chosen(self, grid: GridSpec, proposal: CandidateView) -> ChosenView:
        view = proposal.task.viewpoint
        place = (view.position_world - grid.origin_world_m) / grid.resolution_m
        centre = (proposal.task.centroid_world - grid.origin_world_m) / grid.resolution_m
        rows = self._frontiers.rows()
        away2 = ((self._frontiers.table.rows.centre[rows] - centre) ** 2).sum(axis=1)
        cells = self._frontiers.cluster(int(rows[np.argmin(away2)])).cells
        return ChosenView(np.array([*place, view.yaw_rad, view.pitch_down_rad]), OracleFrontier(cells, *self._mapped.fence))


def request_of(voxels: VoxelMap, posed: PosedFrame) -> PlanRequest:
    """Return the request of a mission that hovers at the frame's pose."""
    return PlanRequest(voxels, None, posed.world_from_depth.translation_m, heading_rad(posed), VIEWS_LEFT)


def heading_rad(posed: PosedFrame) -> float:
    """Return the heading of the optical axis."""
    axis = posed.world_from_depth.rotation()[:, 2]
    return float(np.arctan2(axis[1], axis[0]))


def warm_up(recording: RecordedStream) -> None:
    """Compile every kernel of a replay, then run the first frames on separate objects."""
    mapped = ReplayMap(recording, recording.grid, (recording.low_m, recording.high_m))
    mapped.voxels.warm_up()
    view_planner.warm_up(mapped.config.variant)
    stages, whole = PlannerStages(mapped), mapped.planner()
    mapped.start(recording.frames[0])
    for posed in recording.frames[:WARM_FRAMES]:
        voxels = mapped.fuse(posed, Stopwatch())
        stages.decide(voxels, posed, Stopwatch())
        whole.plan(request_of(voxels, posed))
