"""The last two checkpoints of a refinement, safe against a kill at any time.

A file is the SHA-256 of the content, then the content, written by torch.save(). It is written to a temporary file, synced to
disk, and renamed.
"""

from __future__ import annotations

import hashlib
import io
from pathlib import Path

import torch
from torch import Tensor

from uav_recon import atomic_file

LAST = "checkpoint.pt"
BEFORE = "checkpoint.before.pt"
_DIGEST = hashlib.sha256().digest_size

State = dict[str, Tensor]
Identity = dict[str, float | int | str]


class CheckpointMismatchError(Exception):
    """Raised for a checkpoint of another run; the text names the differences."""


class RefineCheckpoints:
    """The checkpoints in one folder of the run that ``identity`` describes."""

    def __init__(self, folder: Path, identity: Identity) -> None:
        self._folder = folder
        self._identity = identity

    def save(self, state: State) -> None:
        """Write a checkpoint; the last one becomes the one before.

        Raises OSError if it cannot be written.
        """
        buffer = io.BytesIO()
        torch.save({"identity": self._identity, "state": state}, buffer)
        data = buffer.getbuffer()
        self._folder.mkdir(parents=True, exist_ok=True)
        with atomic_file.writing(self._folder / LAST, durable=True, previous=self._folder / BEFORE) as file:
            file.write(hashlib.sha256(data).digest())
            file.write(data)

    def load(self) -> tuple[State | None, list[str]]:
        """Return the newest valid checkpoint, or None, and a message for each damaged one.

        Raises CheckpointMismatchError if it belongs to another run.
        """
        said = []
        for name in (LAST, BEFORE):
            path = self._folder / name
            if not path.exists():
                continue
            held = _read(path)
            if held is None:
                said.append(f"{path}: damaged, left aside")
                continue
            identity, state = held
            self._check(identity, path)
            return state, said
        return None, said

    def _check(self, identity: Identity, path: Path) -> None:
        names = sorted(set(identity) | set(self._identity))
        differ = [f"{n} {identity.get(n)} there, {self._identity.get(n)} here" for n in names if not self._same(identity, n)]
        if differ:
            raise CheckpointMismatchError(f"{path} is of another run: {', '.join(differ)}; move the folder away to start again")

    def _same(self, identity: Identity, name: str) -> bool:
        return name in identity and name in self._identity and identity[name] == self._identity[name]


def _read(path: Path) -> tuple[Identity, State] | None:
    """Return identity and state; None if the file is damaged."""
    data = path.read_bytes()
    if len(data) <= _DIGEST or hashlib.sha256(memoryview(data)[_DIGEST:]).digest() != data[:_DIGEST]:
        return None
    held = torch.load(io.BytesIO(memoryview(data)[_DIGEST:]), map_location="cpu", weights_only=True)
    return held["identity"], held["state"]
