"""Where the tasks of one plan come from: clusters of frontier and surface with a best view each, or a field of gain."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from uav_recon.config import PlannerConfig
from uav_recon.planning.candidate_view import CandidateView, PlanningContext
from uav_recon.planning.frontier.cluster_table import OPENING
from uav_recon.planning.frontier.frontier_views import FrontierViews
from uav_recon.planning.frontier.frontiers import Frontiers
from uav_recon.planning.paths.path_cache import PathCache
from uav_recon.planning.reconstruction.gain_field import FieldViews
from uav_recon.planning.reconstruction.surface_views import SurfaceViews
from uav_recon.planning.variants import Variant
from uav_recon.types.frames import Float32Array, FloatArray
from uav_recon.types.maps import SurfaceElements
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.tasks import PlanMode, TaskKind

MAX_FRONTIERS, MAX_TASKS = 24, 40  # the nearest ones: the horizon executes only the first few


@dataclass(frozen=True, slots=True, eq=False)
class GeneratedTasks:
    """The tasks of one plan. widening: alpha once no opening can be viewed any more, else 1."""

    mode: PlanMode
    proposals: list[CandidateView]
    widening: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class TaskQuery:
    """What a source is asked with: where one plan stands, and what there may be to look at.

    looks: (nx, ny, nz), sum of the cosines under which views have looked at the surface in a voxel. views_left: in the budget.
    """

    situation: PlanningContext
    frontiers: Frontiers
    ways: PathCache
    surface: SurfaceElements | None
    looks: Float32Array
    views_left: int


class TaskSource(Protocol):
    """Makes the tasks of one plan; remembers only what spares it work."""

    def propose(self, question: TaskQuery) -> GeneratedTasks:
        """Look for tasks."""
        ...

    def reasons(self, situation: PlanningContext, frontiers: Frontiers) -> Counter[ReasonCode]:
        """Why frontiers have no view, by reason; slow, for the end."""
        ...


class ClusterTasks:
    """The paper's: the best view of each cluster, surface beside frontiers as the mode says.

    Beyond the paper: surface gets the views that frontiers leave over, its most uncertain first.
    """

    def __init__(self, config: PlannerConfig, variant: Variant, views: FrontierViews, surfaces: SurfaceViews) -> None:
        self._variant, self._end_factor = variant, config.end_factor
        self._views, self._surfaces = views, surfaces

    def propose(self, question: TaskQuery) -> GeneratedTasks:
        """See Source."""
        situation, ways = question.situation, question.ways
        explore = self._explore(situation, question.frontiers)
        ways.update(situation.exit_cells, situation.position_world, places_of(explore))
        opening = np.array([one.task.gain >= OPENING for one in explore], dtype=np.bool_)
        mode = self._variant.mode.choose(ways.lengths_m[0, 1:], opening)
        spare = question.views_left - len(explore)
        if mode is PlanMode.EXPLORE or TaskKind.RECONSTRUCT not in self._variant.kinds or spare <= 0:
            return GeneratedTasks(mode, explore)
        widening = 1.0 if opening.any() else self._end_factor
        surface = self._surfaces.propose(situation, question.surface, question.looks, widening)
        return GeneratedTasks(mode, (explore + surface[:spare])[:MAX_TASKS], widening)

    def reasons(self, situation: PlanningContext, frontiers: Frontiers) -> Counter[ReasonCode]:
        """See Source."""
        if TaskKind.EXPLORE not in self._variant.kinds:
            return Counter()
        return self._views.reasons(situation.voxels, situation.space, frontiers)

    def _explore(self, situation: PlanningContext, frontiers: Frontiers) -> list[CandidateView]:
        """The nearest frontiers' tasks, openings first; each gains what is beyond all that its view shows."""
        if TaskKind.EXPLORE not in self._variant.kinds:
            return []
        found = self._views.update(situation.voxels, situation.space, frontiers, situation.position_world)
        nearest = found.proposals[:MAX_FRONTIERS]
        gains = frontiers.beyond(situation.voxels, [one.promised for one in nearest])
        return [one.gaining(gain) for one, gain in zip(nearest, gains.tolist(), strict=True)]


def places_of(proposals: list[CandidateView]) -> FloatArray:
    """Where their views are: (N, 3), padded voxel units."""
    return np.array([proposal.place for proposal in proposals], dtype=np.float64).reshape(-1, 3)


class GainField:
    """EVPP's: views sampled near the vehicle, the best of a field of gain."""

    def __init__(self, views: FieldViews, reasons: FrontierViews) -> None:
        self._views, self._reasons = views, reasons

    def propose(self, question: TaskQuery) -> GeneratedTasks:
        """See Source."""
        frontiers = question.frontiers.clusters()
        return GeneratedTasks(
            PlanMode.MERGED, self._views.propose(question.situation, frontiers, question.surface, question.looks)
        )

    def reasons(self, situation: PlanningContext, frontiers: Frontiers) -> Counter[ReasonCode]:
        """See Source."""
        return self._reasons.reasons(situation.voxels, situation.space, frontiers)
