"""A firmware's parameters: names in order, each with a type fixed by its default, and their form on the wire."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

INT32 = 6  # MAV_PARAM_TYPE_INT32
REAL32 = 9  # MAV_PARAM_TYPE_REAL32


class ParameterError(ValueError):
    """A parameter file that cannot be loaded; its text names file, line and fault."""


class ParameterTable:
    """Name to value. `revision` grows with each change. What an INT32 looks like on the wire is the firmware's own."""

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
        """Value of an INT32 parameter. Raises KeyError for an unknown name, ValueError for a REAL32 one."""
        value = self._values[name]
        if not isinstance(value, int):
            raise ValueError(f"{name} is not an integer")
        return value

    def kind(self, name: str) -> int:
        """MAV_PARAM_TYPE of a parameter. Raises KeyError for an unknown name."""
        return INT32 if isinstance(self._values[name], int) else REAL32

    def index(self, name: str) -> int:
        """Position in the list that the wire counts. Raises ValueError for an unknown name."""
        return self._names.index(name)

    def name(self, index: int) -> str:
        """Name at a position. Raises IndexError outside the list."""
        if index < 0:
            raise IndexError(index)
        return self._names[index]

    def set(self, name: str, value: float) -> None:
        """Change a value. Raises KeyError for an unknown name, ValueError for a value that does not fit its type."""
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
        """The float of PARAM_VALUE."""
        return self[name]

    def from_wire(self, name: str, wire: float) -> float:
        """The value meant by the float of a PARAM_SET. Raises KeyError for an unknown name."""
        self.kind(name)
        return wire

    def _read(self, path: Path, take_line: Callable[[str], None]) -> None:
        """Hand over each line that is no comment. Raises ParameterError, for a ValueError of take_line too."""
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
