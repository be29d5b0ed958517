"""A serial line that can be unplugged: a pseudo terminal whose device link can be removed."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

_READ_BYTES = 1 << 16


class SerialLine:
    """The autopilot's end of a serial line. Bytes written while it is unplugged are lost."""

    def __init__(self, name: Path) -> None:
        """Create the line under name, the path that the product opens. Raises OSError."""
        self._name = name
        self._end = -1
        self.plug()

    @property
    def arrival_s(self) -> float | None:
        """Arrival time of the last bytes, s; None, since a terminal has no timestamps."""
        return None

    def plug(self) -> None:
        """Create the pseudo terminal and the symbolic link to it."""
        self._end, near = os.openpty()
        os.set_blocking(self._end, False)
        self._name.unlink(missing_ok=True)
        self._name.symlink_to(os.ttyname(near))
        os.close(near)

    def unplug(self) -> None:
        """Remove the link and close the terminal, also for a process that has it open."""
        self._name.unlink(missing_ok=True)
        if self._end >= 0:
            os.close(self._end)
        self._end = -1

    def read(self) -> bytes:
        """Return the bytes that the product sent; b'' if none or if it has not opened the line."""
        with contextlib.suppress(OSError):
            return os.read(self._end, _READ_BYTES)
        return b""

    def write(self, data: bytes) -> None:
        """Send bytes; those that do not fit into the terminal's buffer are lost."""
        with contextlib.suppress(OSError):
            os.write(self._end, data)

    def close(self) -> None:
        """Remove the link and close the terminal."""
        self.unplug()
