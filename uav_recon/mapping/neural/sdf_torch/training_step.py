"""Training steps on one device: eager, then as a CUDA graph."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from uav_recon.mapping.neural.sdf_torch.adam import TorchAdam
from uav_recon.mapping.neural.sdf_torch.distributed import ProcessGroup
from uav_recon.mapping.neural.sdf_torch.ray_sampling import DeviceViews, draw, state_before
from uav_recon.mapping.neural.sdf_torch.sdf_field import TorchSdfField
from uav_recon.types.frames import Float32Array

EAGER_STEPS = 3  # on a side stream before a graph is captured, so that every library has initialised


@dataclass(frozen=True)
class Sampling:
    """Rays per batch, seed of the random stream, and share of the rays from the last views."""

    rays: int
    seed: int
    recent_share: float


class TorchTrainingStep:
    """Trains a field. low_m, high_m (3,): the mapped box."""

    def __init__(
        self,
        field: TorchSdfField,
        views: DeviceViews,
        low_m: Float32Array,
        high_m: Float32Array,
        sampling: Sampling,
        process_group: ProcessGroup,
    ) -> None:
        self._field = field
        self._views = views
        self._sampling = sampling
        self._process_group = process_group
        self._module = process_group.parallel(field)
        self._adam = TorchAdam(field.features, field.weights)
        device = process_group.device
        self._low, self._high = (torch.tensor(corner, device=device) for corner in (low_m, high_m))
        self._stream = torch.tensor(0, device=device)  # the bits of the random state
        self._count, self._rate, self._loss = (torch.tensor(0.0, device=device) for _ in range(3))
        self._stride = state_before(0, process_group.size, sampling.rays)
        self._graph: torch.cuda.CUDAGraph | None = None
        self._eager = 0
        self.steps = 0
        self._rewind()

    def train(self, rate: float) -> None:
        """Run one step at a share of the full learning rate, without waiting for the device."""
        self._rate.fill_(rate)
        if self._graph is not None:
            self._graph.replay()
        elif self._process_group.device.type == "cuda" and self._process_group.size == 1:
            self._warm_step()
        else:
            self._step()
        self.steps += 1

    def loss(self) -> float:
        """Return the loss of the last step; waits for the device."""
        return float(self._loss)

    def state(self) -> dict[str, Tensor]:
        """Return everything that a run needs to resume, in CPU memory."""
        tensors = {**self._parts(), "steps": torch.tensor(self.steps)}
        return {name: tensor.detach().cpu().clone() for name, tensor in tensors.items()}

    @torch.no_grad()
    def restore(self, state: dict[str, Tensor]) -> None:
        """Resume from state(). Raises ValueError if it belongs to another field."""
        for name, tensor in self._parts().items():
            if name not in state or state[name].shape != tensor.shape:
                raise ValueError(f"{name}: not of this field")
        for name, tensor in self._parts().items():
            tensor.copy_(state[name])
        self.steps = int(state["steps"])
        self._rewind()

    def _parts(self) -> dict[str, Tensor]:
        return {
            "features": self._field.features,
            "weights": self._field.weights,
            "feature_moments": self._adam.feature_moments,
            "weight_moments": self._adam.weight_moments,
        }

    def _rewind(self) -> None:
        """Set the random stream and the step count according to the number of steps."""
        draws = self.steps * self._process_group.size + self._process_group.rank
        self._stream.fill_(state_before(self._sampling.seed, draws, self._sampling.rays))
        self._count.fill_(float(self.steps))

    def _step(self) -> None:
        batch = draw(self._stream, self._views, self._low, self._high, self._sampling.rays, self._sampling.recent_share)
        self._field.zero_grad(set_to_none=True)
        loss = self._module(batch)
        loss.backward()
        self._count += 1.0
        self._adam.step(self._field.features, self._field.weights, self._count, self._rate)
        self._stream += self._stride
        self._loss.copy_(loss.detach())

    def _warm_step(self) -> None:
        """Run the first steps eagerly, then capture one as a graph.

        Later steps replay the graph.
        """
        if self._eager < EAGER_STEPS:
            side = torch.cuda.Stream()  # type: ignore[no-untyped-call]
            side.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(side):
                self._step()
            torch.cuda.current_stream().wait_stream(side)
            self._eager += 1
            return
        self._field.zero_grad(set_to_none=True)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            self._step()
        self._graph = graph
        graph.replay()
