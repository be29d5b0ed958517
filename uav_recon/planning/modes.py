"""When to explore alone and when to merge exploring with looking at uncertain surface (paper, section III-C)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from uav_recon.types.frames import FloatArray
from uav_recon.types.tasks import PlanMode

HURRY = 0.4


class ModeRule(Protocol):
    """Chooses the mode of one plan; never blocks.

    It knows the path lengths (N,) in metres to the frontiers that can be viewed, and which share of the views is spent.
    """

    def choose(self, frontier_distance_m: FloatArray, spent: float) -> PlanMode:
        """Return the mode."""
        ...


@dataclass(frozen=True, slots=True)
class Adaptive:
    """V5: explore while more than ``near_count`` frontiers are near and they are more than ``near_share`` of all.

    Beyond the paper: once HURRY of the views is spent, frontiers come first, near or not. Surface that can be looked at again
    is always near; a second room would wait for ever.
    """

    near_distance_m: float
    near_count: int
    near_share: float

    def choose(self, frontier_distance_m: FloatArray, spent: float) -> PlanMode:
        """N_near and beta_near by PATH length: a frontier behind a wall is not near."""
        if spent > HURRY and len(frontier_distance_m):
            return PlanMode.EXPLORE
        near = int(np.count_nonzero(frontier_distance_m <= self.near_distance_m))
        share = near / max(len(frontier_distance_m), 1)
        return PlanMode.EXPLORE if near > self.near_count and share > self.near_share else PlanMode.MERGED


@dataclass(frozen=True, slots=True)
class ExploreOnly:
    """V1 and V2: frontiers, and nothing after them."""

    def choose(self, frontier_distance_m: FloatArray, spent: float) -> PlanMode:
        """Explore."""
        return PlanMode.EXPLORE


@dataclass(frozen=True, slots=True)
class AlwaysMerged:
    """V3, V4 and the baselines: whatever there is to see, from the start."""

    def choose(self, frontier_distance_m: FloatArray, spent: float) -> PlanMode:
        """Merge."""
        return PlanMode.MERGED


@dataclass(frozen=True, slots=True)
class ExploreThenRefine:
    """The baseline that the paper leaves out: no look at surface until no frontier can be viewed any more."""

    def choose(self, frontier_distance_m: FloatArray, spent: float) -> PlanMode:
        """Explore while there is a frontier."""
        return PlanMode.EXPLORE if len(frontier_distance_m) else PlanMode.MERGED
