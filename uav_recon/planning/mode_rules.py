"""When to explore alone and when to merge exploring with looking at uncertain surface (paper, section III-C)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from uav_recon.types.frames import BoolArray, FloatArray
from uav_recon.types.tasks import PlanMode


class ModeRule(Protocol):
    """Chooses the mode of one plan; never blocks.

    It knows the path lengths (N,) in metres to the frontiers that can be viewed, and which of them (N,) are openings: with room
    beyond them, and not gaps in front of a wall.
    """

    def choose(self, frontier_distance_m: FloatArray, opening: BoolArray) -> PlanMode:
        """Return the mode."""
        ...


@dataclass(frozen=True, slots=True)
class Adaptive:
    """V5: explore while more than ``near_count`` frontiers are near and they are more than ``near_share`` of all.

    Beyond the paper: only openings count. Gaps in front of walls are near wherever one is, and would always win.
    """

    near_distance_m: float
    near_count: int
    near_share: float

    def choose(self, frontier_distance_m: FloatArray, opening: BoolArray) -> PlanMode:
        """N_near and beta_near by PATH length: a frontier behind a wall is not near."""
        near = int(np.count_nonzero(frontier_distance_m[opening] <= self.near_distance_m))
        share = near / max(int(np.count_nonzero(opening)), 1)
        return PlanMode.EXPLORE if near > self.near_count and share > self.near_share else PlanMode.MERGED


@dataclass(frozen=True, slots=True)
class ExploreOnly:
    """V1 and V2: frontiers, and nothing after them."""

    def choose(self, frontier_distance_m: FloatArray, opening: BoolArray) -> PlanMode:
        """Explore."""
        return PlanMode.EXPLORE


@dataclass(frozen=True, slots=True)
class AlwaysMerged:
    """V3, V4 and the baselines: whatever there is to see, from the start."""

    def choose(self, frontier_distance_m: FloatArray, opening: BoolArray) -> PlanMode:
        """Merge."""
        return PlanMode.MERGED


@dataclass(frozen=True, slots=True)
class ExploreThenRefine:
    """The baseline that the paper leaves out: no look at surface until no frontier can be viewed any more."""

    def choose(self, frontier_distance_m: FloatArray, opening: BoolArray) -> PlanMode:
        """Explore while there is a frontier."""
        return PlanMode.EXPLORE if len(frontier_distance_m) else PlanMode.MERGED
