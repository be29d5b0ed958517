"""The processes that learn together, one for each GPU: torch.distributed, or one process by itself."""

from __future__ import annotations

import os

import torch
from torch import distributed, nn
from torch.nn.parallel import DistributedDataParallel

DEVICES = ("auto", "cpu", "cuda")
FullDeviceError = torch.OutOfMemoryError


class DeviceError(Exception):
    """A device that this machine lacks, in one line."""


def device_kind(name: str) -> str:
    """cpu or cuda for one of DEVICES; auto takes a GPU where there is one. Raises DeviceError."""
    if name not in DEVICES:
        raise DeviceError(f"{name}: want {', '.join(DEVICES)}")
    found = torch.cuda.is_available()
    if name == "cuda" and not found:
        raise DeviceError("cuda: torch sees no GPU here; want auto or cpu")
    return "cuda" if found and name != "cpu" else "cpu"


def gpus() -> int:
    """How many torch sees."""
    return torch.cuda.device_count()


class ProcessGroup:
    """This process among those which torchrun started; alone without it. kind: as device_kind() says."""

    def __init__(self, kind: str) -> None:
        self.rank, self.size = int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1"))
        local = int(os.environ.get("LOCAL_RANK", "0"))
        self.device = torch.device(kind, local) if kind == "cuda" else torch.device("cpu")
        if kind == "cuda":
            torch.cuda.set_device(self.device)
        if self.size > 1:
            distributed.init_process_group("nccl" if kind == "cuda" else "gloo")

    @property
    def leads(self) -> bool:
        """Whether this process speaks and writes for all."""
        return self.rank == 0

    def parallel(self, module: nn.Module) -> nn.Module:
        """The module, whose gradients become the mean over the team."""
        if self.size == 1:
            return module
        return DistributedDataParallel(module, gradient_as_bucket_view=True)

    def any(self, flag: bool) -> bool:
        """Whether one of the team says so; all must ask."""
        if self.size == 1:
            return flag
        votes = torch.tensor(float(flag), device=self.device)
        distributed.all_reduce(votes, distributed.ReduceOp.MAX)
        return bool(votes > 0)

    def leave(self) -> None:
        """Say good-bye, once all have come so far."""
        if self.size > 1:
            distributed.barrier()
            distributed.destroy_process_group()
