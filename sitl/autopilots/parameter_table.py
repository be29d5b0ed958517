"""Table of a firmware's parameters, sorted by name, each with the type of its default value."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

INT32 = 6  # MAV_PARAM_TYPE_INT32
REAL32 = 9  # MAV_PARAM_TYPE_REAL32


class ParameterError(ValueError):
    """The parameter file cannot be loaded; the message names file, line and cause."""


class ParameterTable:
    """Parameter values by name. `revision` increases with each change.

    Subclasses define the wire format of an INT32.
    """

    def __init__(self, defaults: Mapping[str, int | float]) -> None:
        self._values: dict[str, int | float] = dict(sorted(defaults.items()))
        self._names = list(self._values)
        self.revision = 0

    def __getitem__(self, name: str) -> float:
        return float(self._values[name])

    def __contains__(self, name: object) -> bool:
        return name in self._values

    def __len__(self) -> int:
        return len(self._names)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def integer(self, name: str) -> int:
        """Return an INT32 value. Raises KeyError for an unknown name, ValueError for a REAL32."""
        value = self._values[name]
        if not isinstance(value, int):
            raise ValueError(f"{name} is not an integer")
        return value

    def kind(self, name: str) -> int:
        """Return the MAV_PARAM_TYPE of a parameter. Raises KeyError for an unknown name."""
        return INT32 if isinstance(self._values[name], int) else REAL32

    def index(self, name: str) -> int:
        """Return the param_index of a parameter. Raises ValueError for an unknown name."""
        return self._names.index(name)

    def name(self, index: int) -> str:
        """Return the name at a param_index. Raises IndexError outside the list."""
        if index < 0:
            raise IndexError(index)
        return self._names[index]

    def set(self, name: str, value: float) -> None:
        """Change a value. Raises KeyError for an unknown name, ValueError for an invalid value."""
        if self.kind(name) == INT32:
            if value != int(value) or not -(2**31) <= value < 2**31:
                raise ValueError(f"{name} needs a 32-bit integer, got {value!r}")
            self._values[name] = int(value)
        else:
            if not math.isfinite(value):
                raise ValueError(f"{name} needs a finite number, got {value!r}")
            self._values[name] = struct.unpack("<f", struct.pack("<f", value))[0]
        self.revision += 1

    def on_wire(self, name: str) -> float:
        """Return the float that PARAM_VALUE carries."""
        return self[name]

    def from_wire(self, name: str, wire: float) -> float:
        """Return the value of the float in a PARAM_SET. Raises KeyError for an unknown name."""
        self.kind(name)
        return wire

    def _read(self, path: Path, take_line: Callable[[str], None]) -> None:
        """Call take_line for each line that is not empty or a comment.

        Raises ParameterError if the file cannot be read or take_line raises ValueError.
        """
        try:
            lines = path.read_text(encoding="utf-8").splitlines()
        except OSError as error:
            raise ParameterError(f"{path}: cannot be read ({error.strerror})") from None
        for number, line in enumerate(lines, start=1):
            if line.startswith("#") or not line.strip():
                continue
            try:
                take_line(line)
            except ValueError as error:
                raise ParameterError(f"{path}:{number}: {error}") from None
