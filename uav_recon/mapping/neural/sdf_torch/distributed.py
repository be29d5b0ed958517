"""Process group for training on several GPUs: torch.distributed, or a single process."""

from __future__ import annotations

import os

import torch
from torch import distributed, nn
from torch.nn.parallel import DistributedDataParallel

DEVICES = ("auto", "cpu", "cuda")
FullDeviceError = torch.OutOfMemoryError


class DeviceError(Exception):
    """Raised for a device that this machine lacks; the text is one line."""


def device_kind(name: str) -> str:
    """Return cpu or cuda for one of DEVICES; auto selects a GPU if there is one.

    Raises DeviceError for an unknown or missing device.
    """
    if name not in DEVICES:
        raise DeviceError(f"{name}: want {', '.join(DEVICES)}")
    found = torch.cuda.is_available()
    if name == "cuda" and not found:
        raise DeviceError("cuda: torch sees no GPU here; want auto or cpu")
    return "cuda" if found and name != "cpu" else "cpu"


def gpus() -> int:
    """Return the number of GPUs that torch finds."""
    return torch.cuda.device_count()


class ProcessGroup:
    """This process within the group started by torchrun, or alone without it.

    kind: as from device_kind(); one process per GPU.
    """

    def __init__(self, kind: str) -> None:
        self.rank = int(os.environ.get("RANK", "0"))
        self.size = int(os.environ.get("WORLD_SIZE", "1"))
        local = int(os.environ.get("LOCAL_RANK", "0"))
        self.device = torch.device(kind, local) if kind == "cuda" else torch.device("cpu")
        if kind == "cuda":
            torch.cuda.set_device(self.device)
        if self.size > 1:
            distributed.init_process_group("nccl" if kind == "cuda" else "gloo")

    @property
    def is_main(self) -> bool:
        """True if this process logs and writes for the group."""
        return self.rank == 0

    def parallel(self, module: nn.Module) -> nn.Module:
        """Return the module with its gradients averaged over the group."""
        if self.size == 1:
            return module
        return DistributedDataParallel(module, gradient_as_bucket_view=True)

    def any(self, flag: bool) -> bool:
        """Return True if the flag is set in any process. All processes must call this."""
        if self.size == 1:
            return flag
        votes = torch.tensor(float(flag), device=self.device)
        distributed.all_reduce(votes, distributed.ReduceOp.MAX)
        return bool(votes > 0)

    def shutdown(self) -> None:
        """Leave the group, once all processes have reached this call."""
        if self.size > 1:
            distributed.barrier()
            distributed.destroy_process_group()
