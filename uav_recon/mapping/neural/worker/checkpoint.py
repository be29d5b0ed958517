"""Checkpoints of the mapper: a new child resumes a few views before the last one stopped.

This also works after kill -9. Folder: ``state`` holds the whole mapper except the arrays of the views (rays and depth
image). These do not change, so each view has its own file that is written once. The cost of a checkpoint depends on what was
learned, not on what was observed. Files are replaced atomically (written to a temporary file, synced, renamed), and
``state`` is written last. Not stored: the keyframes (they are already on disk), compiled kernels and scratch memory. A
checkpoint is valid for one set of start parameters (configuration, box, noise), one set of keyframes and one version of this
code.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import pickle
import threading
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from uav_recon import atomic_file, json_codec
from uav_recon.mapping.keyframe_store import KeyframeFolder
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.types.frames import AnyArray

LOG = logging.getLogger(__name__)

STATE = "state"
VIEW = "view_{:06d}.npz"
# the limit reached first applies: relearning eight views takes a second
EVERY_VIEWS = 8
EVERY_STEPS = 2000
OURS = ("uav_recon.mapping.neural.", "uav_recon.types.")  # modules whose classes a state may contain
OTHERS = {("uav_recon.config", "MapperConfig"), ("collections", "Counter")} | {
    (module, "PosixPath") for module in ("pathlib", "pathlib._local")
}
NUMPY = {"_frombuffer", "_reconstruct", "dtype", "ndarray", "scalar", "PCG64", "SeedSequence"} | {
    "__generator_ctor", "__bit_generator_ctor", "__pyx_unpickle_SeedSequence"
}  # fmt: skip


class CheckpointError(Exception):
    """Raised for a checkpoint that cannot be used; the text names the file and the fault."""


@dataclass(frozen=True)
class _Header:
    """Header of a state file, one line of JSON.

    learned: number of keyframes processed; stamp_s: stamp of the last one; views: number and CRC-32 of each view file.
    """

    order: str
    code: str
    learned: int
    stamp_s: float
    views: list[tuple[int, int]]


class MapperCheckpoints:
    """The checkpoints of one flight.

    save_if_due() returns at once and a thread writes; load() blocks. order: all parameters that a mapper is created from.
    """

    def __init__(self, folder: Path, order: dict[str, Any]) -> None:
        self._folder = folder
        self._order = hashlib.sha256(json.dumps(order, sort_keys=True).encode()).hexdigest()
        self._code = _code()
        self._writer = threading.Thread()
        self._sums: dict[int, int] = {}  # CRC-32 of each view on disk
        # of the newest checkpoint
        self._learned = 0
        self._steps = 0

    def load(self, keyframes: KeyframeFolder) -> tuple[NeuralMapper, int] | None:
        """Return the mapper and the number of keyframes it processed; None without a checkpoint.

        Raises CheckpointError if it is damaged or belongs to other parameters, other code or another flight.
        """
        path = self._folder / STATE
        if not path.exists():
            return None
        try:
            sealed, _, content = path.read_bytes().partition(b"\n")
            if sealed != f"{zlib.crc32(content):08x}".encode():
                raise CheckpointError(f"{path}: damaged")
            line, _, payload = content.partition(b"\n")
            header = json_codec.from_text(_Header, line)
            self._check(header, keyframes)
            trainer: NeuralMapper = _Unpickler(io.BytesIO(payload)).load()
            for index, (number, crc32) in enumerate(header.views):
                trainer.put_back(index, self._view(number, crc32))
        except (OSError, ValueError, TypeError, KeyError, EOFError, pickle.UnpicklingError) as error:
            raise CheckpointError(f"{path}: damaged ({error})") from None
        self._sums = dict(header.views)
        self._learned = header.learned
        self._steps = trainer.steps
        return trainer, header.learned

    def save_if_due(self, trainer: NeuralMapper, learned: int, stamp_s: float) -> bool:
        """Start writing a checkpoint if the last one is old; returns True if started.

        Returns False also while the last one is still being written. learned: number of keyframes processed; stamp_s: stamp
        of the last of them. Blocks for a copy of the state.
        """
        young = learned - self._learned < EVERY_VIEWS and trainer.steps - self._steps < EVERY_STEPS
        if young or self._writer.is_alive():
            return False
        header = _Header(self._order, self._code, learned, stamp_s, [(number, 0) for number in trainer.kept])
        fresh = {n: trainer.view_arrays(i) for i, n in enumerate(trainer.kept) if n not in self._sums}
        arguments = (header, pickle.dumps(trainer, protocol=5), fresh)
        self._learned = learned
        self._steps = trainer.steps
        self._writer = threading.Thread(target=self._write, args=arguments, name="checkpoint", daemon=True)
        self._writer.start()
        return True

    def wait(self) -> None:
        """Block until a started checkpoint is on disk."""
        if self._writer.ident is not None:
            self._writer.join()

    def _check(self, header: _Header, keyframes: KeyframeFolder) -> None:
        path = self._folder / STATE
        if header.order != self._order:
            raise CheckpointError(f"{path}: of another configuration, box or camera")
        if header.code != self._code:
            raise CheckpointError(f"{path}: of another version of this software")
        if header.learned > len(keyframes) or keyframes.stamp_s(header.learned - 1) != header.stamp_s:
            raise CheckpointError(f"{path}: of other keyframes")

    def _view(self, number: int, crc32: int) -> dict[str, AnyArray]:
        path = self._folder / VIEW.format(number)
        packed = path.read_bytes()
        if zlib.crc32(packed) != crc32:
            raise CheckpointError(f"{path}: damaged")
        with np.load(io.BytesIO(packed), allow_pickle=False) as arrays:
            return dict(arrays)

    def _write(self, header: _Header, payload: bytes, fresh: dict[int, dict[str, AnyArray]]) -> None:
        """Write the views, then the state that needs them; then delete the old views.

        If the disk is full, only the checkpoint is lost.
        """
        try:
            self._folder.mkdir(exist_ok=True)
            for number, arrays in fresh.items():
                packed = io.BytesIO()
                np.savez(packed, **arrays)  # type: ignore[arg-type]
                atomic_file.replace(self._folder / VIEW.format(number), packed.getbuffer(), durable=True)
                self._sums[number] = zlib.crc32(packed.getbuffer())
            self._sums = {number: self._sums[number] for number, _ in header.views}
            line = json_codec.to_line(replace(header, views=list(self._sums.items()))).encode() + b"\n"
            sealed = f"{zlib.crc32(payload, zlib.crc32(line)):08x}\n".encode()
            with atomic_file.writing(self._folder / STATE, durable=True) as file:
                file.writelines((sealed, line, payload))
            wanted = {STATE, *(VIEW.format(number) for number in self._sums)}
            for path in self._folder.iterdir():
                if path.name not in wanted:
                    path.unlink()
        except OSError as error:
            LOG.warning("no checkpoint after %d keyframes: %s", header.learned, error)


class _Unpickler(pickle.Unpickler):
    """Unpickler restricted to objects of the mapper and arrays."""

    def find_class(self, module: str, name: str) -> Any:
        """Return an allowed class. Raises UnpicklingError for all others."""
        ours = module.startswith(OURS) or (module, name) in OTHERS
        arrays = (module == "numpy" or module.startswith("numpy.")) and name in NUMPY
        if "." in name or not (ours or arrays):
            raise pickle.UnpicklingError(f"{module}.{name} has no place in a checkpoint")
        return super().find_class(module, name)


def _code() -> str:
    """Return a hash of all source of this package, which identifies the code of a state."""
    text = b"".join(path.read_bytes() for path in sorted(Path(__file__).parents[1].rglob("*.py")))
    return hashlib.sha256(text).hexdigest()
