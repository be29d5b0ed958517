"""Rules that choose between exploration alone and merged exploration (paper, section III-C)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from uav_recon.types.frames import FloatArray, IntArray
from uav_recon.types.tasks import PlanMode


class ModeRule(Protocol):
    """Chooses the mode of one plan; never blocks.

    frontier_distance_m: (N,) path lengths in metres to the views of the nearest frontiers.
    openings: (N,) number of frontier clusters with unknown space beyond them that each view stands for; 0 for gaps in front of
    a wall.
    farther_openings: number of such clusters without a view among these.
    """

    def choose(self, frontier_distance_m: FloatArray, openings: IntArray, farther_openings: int) -> PlanMode:
        """Return the mode."""
        ...


@dataclass(frozen=True, slots=True)
class Adaptive:
    """V5: explore while many openings are near, else merge.

    Many means more than ``near_count`` openings, and more than ``near_share`` of all openings. Near and far ones are counted as
    clusters, as in the paper, and not as the views that cover them.

    Difference from the paper: only openings count. Gaps in front of walls are near at every position and would always
    dominate.
    """

    near_distance_m: float
    near_count: int
    near_share: float

    def choose(self, frontier_distance_m: FloatArray, openings: IntArray, farther_openings: int) -> PlanMode:
        """Compute N_near and beta_near by PATH length, so that a frontier behind a wall is not near."""
        near = int(openings[frontier_distance_m <= self.near_distance_m].sum())
        share = near / max(int(openings.sum()) + farther_openings, 1)
        return PlanMode.EXPLORE if near > self.near_count and share > self.near_share else PlanMode.MERGED


@dataclass(frozen=True, slots=True)
class ExploreOnly:
    """V1 and V2: frontier tasks only."""

    def choose(self, frontier_distance_m: FloatArray, openings: IntArray, farther_openings: int) -> PlanMode:
        """Return EXPLORE."""
        return PlanMode.EXPLORE


@dataclass(frozen=True, slots=True)
class AlwaysMerged:
    """V3, V4 and the baselines: frontier and surface tasks from the start."""

    def choose(self, frontier_distance_m: FloatArray, openings: IntArray, farther_openings: int) -> PlanMode:
        """Return MERGED."""
        return PlanMode.MERGED


@dataclass(frozen=True, slots=True)
class ExploreThenRefine:
    """A baseline that is not in the paper: no surface tasks while a frontier can be viewed."""

    def choose(self, frontier_distance_m: FloatArray, openings: IntArray, farther_openings: int) -> PlanMode:
        """Return EXPLORE while there is a frontier, else MERGED."""
        return PlanMode.EXPLORE if len(frontier_distance_m) else PlanMode.MERGED
