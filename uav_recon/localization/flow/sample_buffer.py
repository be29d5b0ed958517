"""Sample buffer: the newest rows of a stream of numbers, as one array."""

from __future__ import annotations

import numpy as np

from uav_recon.types.frames import FloatArray


class SampleBuffer:
    """Keeps at least ``kept`` rows of ``columns`` numbers; the first one is a stamp."""

    def __init__(self, kept: int, columns: int) -> None:
        self._kept = kept
        self._rows = np.empty((2 * kept, columns))
        self._count = 0

    def append(self, *numbers: float) -> None:
        """Add a row."""
        if self._count == len(self._rows):
            self._rows[: self._kept] = self._rows[-self._kept :]
            self._count = self._kept
        self._rows[self._count] = numbers
        self._count += 1

    def clear(self) -> None:
        """Remove all rows."""
        self._count = 0

    @property
    def newest_s(self) -> float:
        """Stamp of the newest row, -inf without one."""
        return float(self._rows[self._count - 1, 0]) if self._count else -np.inf

    def rows(self) -> FloatArray:
        """Return all rows, oldest first, without a copy."""
        return self._rows[: self._count]

    def between(self, from_s: float, to_s: float) -> FloatArray:
        """Return the rows with a stamp in [from_s, to_s], without a copy."""
        stamps_s = self._rows[: self._count, 0]
        return self._rows[np.searchsorted(stamps_s, from_s) : np.searchsorted(stamps_s, to_s, side="right")]
