"""Rules that choose between exploration alone and merged exploration (paper, section III-C)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from uav_recon.types.frames import BoolArray, FloatArray
from uav_recon.types.tasks import PlanMode


class ModeRule(Protocol):
    """Chooses the mode of one plan; never blocks.

    frontier_distance_m: (N,) path lengths in metres to the nearest frontiers that can be viewed.
    opening: (N,) True for frontiers with unknown space beyond them, False for gaps in front of a wall.
    farther_openings: number of openings that are not among these.
    """

    def choose(self, frontier_distance_m: FloatArray, opening: BoolArray, farther_openings: int) -> PlanMode:
        """Return the mode."""
        ...


@dataclass(frozen=True, slots=True)
class Adaptive:
    """V5: explore while many openings are near, else merge.

    Many means more than ``near_count`` openings, and more than ``near_share`` of all openings.

    Difference from the paper: only openings count. Gaps in front of walls are near at every position and would always
    dominate.
    """

    near_distance_m: float
    near_count: int
    near_share: float

    def choose(self, frontier_distance_m: FloatArray, opening: BoolArray, farther_openings: int) -> PlanMode:
        """Compute N_near and beta_near by PATH length, so that a frontier behind a wall is not near."""
        near = int(np.count_nonzero(frontier_distance_m[opening] <= self.near_distance_m))
        share = near / max(int(np.count_nonzero(opening)) + farther_openings, 1)
        return PlanMode.EXPLORE if near > self.near_count and share > self.near_share else PlanMode.MERGED


@dataclass(frozen=True, slots=True)
class ExploreOnly:
    """V1 and V2: frontier tasks only."""

    def choose(self, frontier_distance_m: FloatArray, opening: BoolArray, farther_openings: int) -> PlanMode:
        """Return EXPLORE."""
        return PlanMode.EXPLORE


@dataclass(frozen=True, slots=True)
class AlwaysMerged:
    """V3, V4 and the baselines: frontier and surface tasks from the start."""

    def choose(self, frontier_distance_m: FloatArray, opening: BoolArray, farther_openings: int) -> PlanMode:
        """Return MERGED."""
        return PlanMode.MERGED


@dataclass(frozen=True, slots=True)
class ExploreThenRefine:
    """A baseline that is not in the paper: no surface tasks while a frontier can be viewed."""

    def choose(self, frontier_distance_m: FloatArray, opening: BoolArray, farther_openings: int) -> PlanMode:
        """Return EXPLORE while there is a frontier, else MERGED."""
        return PlanMode.EXPLORE if len(frontier_distance_m) else PlanMode.MERGED
