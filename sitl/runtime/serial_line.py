"""A serial line that can be unplugged: a pseudo terminal under a name that comes and goes, as a device below /dev does."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

_READ_BYTES = 1 << 16


class SerialLine:
    """The autopilot's end of it. What is said into a line that is unplugged is lost."""

    def __init__(self, name: Path) -> None:
        """name: what the product opens. Raises OSError if it cannot be made."""
        self._name, self._end = name, -1
        self.plug()

    @property
    def arrival_s(self) -> float | None:
        """Unknown: a terminal dates nothing."""
        return None

    def plug(self) -> None:
        """The device is there."""
        self._end, near = os.openpty()
        os.set_blocking(self._end, False)
        self._name.unlink(missing_ok=True)
        self._name.symlink_to(os.ttyname(near))
        os.close(near)

    def unplug(self) -> None:
        """It is gone, for whoever has it open too."""
        self._name.unlink(missing_ok=True)
        if self._end >= 0:
            os.close(self._end)
        self._end = -1

    def read(self) -> bytes:
        """What the product said, b'' if nothing or if nobody has it open."""
        with contextlib.suppress(OSError):
            return os.read(self._end, _READ_BYTES)
        return b""

    def write(self, data: bytes) -> None:
        """Send; what nobody takes in is lost."""
        with contextlib.suppress(OSError):
            os.write(self._end, data)

    def close(self) -> None:
        """For good."""
        self.unplug()
