"""Refinement of a flight: trains a finer field on all views at once."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
import torch
from torch import Tensor

from uav_recon.mapping.neural.keyframes.ray_buffer import OFFSETS_M
from uav_recon.mapping.neural.sdf_torch.checkpoint import Identity
from uav_recon.mapping.neural.sdf_torch.distributed import ProcessGroup
from uav_recon.mapping.neural.sdf_torch.feature_grid import FeatureBlocks, lay_out
from uav_recon.mapping.neural.sdf_torch.ray_sampling import DeviceViews
from uav_recon.mapping.neural.sdf_torch.sdf_field import TorchSdfField
from uav_recon.mapping.neural.sdf_torch.training_step import Sampling, TorchTrainingStep
from uav_recon.mapping.neural.training_data import TrainingData

FINAL_RATE = 0.05  # share of the learning rate at the last step; it falls from the middle of the run
CELL_VOXELS = 2.0  # finest grid cell in mesh voxels: a trilinear cell resolves two samples


@dataclass(frozen=True)
class RefinePlan:
    """Parameters of a refinement; equal plan and equal flight mean the same run."""

    steps: int
    voxel_m: float
    rays: int
    seed: int

    def identity(self, flight: str) -> Identity:
        """Return the identity for checkpoints; flight: digest of the views."""
        return {**asdict(self), "flight": flight}


class Refiner:
    """A refinement run: call advance() until done."""

    def __init__(self, gathered: TrainingData, plan: RefinePlan, process_group: ProcessGroup) -> None:
        """Prepare the run. Raises GridError if the box is too large for the voxel."""
        self._plan = plan
        layout = lay_out(gathered.low_m.astype(np.float64), gathered.high_m.astype(np.float64), CELL_VOXELS * plan.voxel_m)
        blocks = FeatureBlocks(layout)
        for points, direction in _rays(gathered):
            blocks.cover(points, direction)
        self.field = TorchSdfField(layout, *blocks.slots(), plan.seed, process_group.device)
        views = DeviceViews.of(gathered.replay.views, gathered.replay.count, process_group.device)
        sampling = Sampling(plan.rays, plan.seed, recent_share=0.0)
        self._learner = TorchTrainingStep(self.field, views, gathered.low_m, gathered.high_m, sampling, process_group)

    @property
    def steps(self) -> int:
        """Number of steps done."""
        return self._learner.steps

    @property
    def done(self) -> bool:
        """True if all steps of the plan are done."""
        return self.steps >= self._plan.steps

    def advance(self, steps: int) -> float:
        """Run at most ``steps`` more steps; returns the last loss."""
        for _ in range(min(steps, self._plan.steps - self.steps)):
            self._learner.train(FINAL_RATE ** max(0.0, 2.0 * self.steps / self._plan.steps - 1.0))
        return self._learner.loss()

    def state(self) -> dict[str, Tensor]:
        """Return everything that is needed to resume."""
        return self._learner.state()

    def restore(self, state: dict[str, Tensor]) -> None:
        """Resume from state()."""
        self._learner.restore(state)


def _rays(gathered: TrainingData) -> list[tuple[Tensor, Tensor]]:
    """Return measured points (N, 3) and unit directions (N, 3) of each view."""
    replay, found = gathered.replay, []
    v = replay.views
    for n in range(replay.count):
        records = v.records[v.first[n] : v.first[n + 1]]
        points = replay.rays(records, v.rotation[n], v.position[n], float(v.inverse_depth_sigma[n]), v.stretch[n]).points
        direction = (points[0] - points[1]) / (OFFSETS_M[0] - OFFSETS_M[1])
        found.append((torch.from_numpy(points[0]), torch.from_numpy(direction)))
    return found
