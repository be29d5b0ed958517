"""The paper's variants and baselines, for `uav-recon sim --variant NAME` and benchmarks."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from uav_recon.config import PlannerConfig, VariantName
from uav_recon.planning.camera_frustum import CameraGeometry
from uav_recon.planning.mode_rules import Adaptive, AlwaysMerged, ExploreOnly, ExploreThenRefine, ModeRule
from uav_recon.planning.tour.stopping_rule import StoppingRule
from uav_recon.planning.tour.task_ordering import FrontierWithDetours, Greedy, TaskOrdering, Tour
from uav_recon.types.tasks import TaskKind

BOTH = frozenset(TaskKind)


@dataclass(frozen=True, slots=True, eq=False)
class Variant:
    """The parts of a planner.

    A task ordering holds the state of one flight: make one variant per planner.

    kinds: kinds of tasks that are generated.
    mode_rule: rule that decides when surface tasks are generated beside frontier tasks.
    task_ordering: orders the tasks and drops those not worth a flight.
    camera: restricts the use of the mount.
    views: source of the tasks: one best view per cluster, or the gain field.
    """

    name: VariantName
    kinds: frozenset[TaskKind]
    mode_rule: ModeRule
    task_ordering: TaskOrdering
    camera: Callable[[CameraGeometry], CameraGeometry]
    views: Literal["clusters", "field"] = "clusters"


def variant(name: VariantName, config: PlannerConfig) -> Variant:
    """Make a variant by its name; ``config.variant`` is not read."""
    stopping_rule = StoppingRule(config.worth_share)
    explore, surface = frozenset({TaskKind.EXPLORE}), frozenset({TaskKind.RECONSTRUCT})
    adaptive = Adaptive(config.near_distance_m, config.near_count, config.near_share)
    made: dict[VariantName, Variant] = {
        "adaptive": Variant("adaptive", BOTH, adaptive, Tour(stopping_rule), as_mounted),  # V5
        "merged": Variant("merged", BOTH, AlwaysMerged(), Tour(stopping_rule), as_mounted),  # V4
        "reconstruct": Variant("reconstruct", surface, AlwaysMerged(), Tour(stopping_rule), as_mounted),  # V3
        "explore": Variant("explore", explore, ExploreOnly(), Tour(stopping_rule), as_mounted),  # V2
        "explore-yaw": Variant("explore-yaw", explore, ExploreOnly(), Tour(stopping_rule), yaw_only),  # V1
        "explore-then-refine": Variant("explore-then-refine", BOTH, ExploreThenRefine(), Tour(stopping_rule), as_mounted),
        "evpp": Variant("evpp", BOTH, AlwaysMerged(), Greedy(stopping_rule), as_mounted, views="field"),
        "vpp": Variant("vpp", BOTH, AlwaysMerged(), FrontierWithDetours(stopping_rule), as_mounted),
    }
    return made[name]


def as_mounted(camera: CameraGeometry) -> CameraGeometry:
    """Return the camera with the full range of the mount."""
    return camera


def yaw_only(camera: CameraGeometry) -> CameraGeometry:
    """Return the camera with a fixed pitch, level or as near to level as the mount allows."""
    pitch_rad = min(max(0.0, camera.pitch_min_rad), camera.pitch_max_rad)
    return dataclasses.replace(camera, pitch_min_rad=pitch_rad, pitch_max_rad=pitch_rad)
