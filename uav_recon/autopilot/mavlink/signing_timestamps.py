"""Timestamps of signed frames, ours and the vehicle's.

They are stored in a file, so that no restart makes an old frame valid again.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from pathlib import Path

from uav_recon import atomic_file
from uav_recon.interfaces import Executor

UNITS_PER_S = 100_000  # MAVLink counts tens of microseconds since 2015-01-01
AHEAD_S = 10.0  #: internal: the file is this far beyond our used stamps; less than the minute by which a frame may be late
LATE_S = 60.0  #: reject: the first frame of a sender that is farther behind us (mavlink.io, Message Signing)
_EPOCH_S = 1420070400.0
_END = 1 << 48

Stream = tuple[int, int, int]  # link id, system, component


class SigningTimestampsError(Exception):
    """A file that cannot be used; its text is one line that names it."""


class SigningTimestamps:
    """Stamps of our frames and newest stamps of other senders.

    Ours increase with the injected clock and never decrease: not over restarts, crashes, or a wall clock that was set.

    The file is written with a stamp beyond those in use, at the start and then about every five seconds on the executor.
    A sender's newest stamp is written with it: after a crash, its frames of the last seconds could be replayed;
    after close(), none.
    """

    def __init__(self, path: Path, wall_s: float, now_s: float, executor: Executor) -> None:
        """Read the file and write it ahead.

        wall_s: seconds since 1970, used once. Raises SigningTimestampsError if the file cannot be read or written.
        """
        self._path = path
        self._executor = executor
        self._start_s = now_s
        stored, self._newest = _read(path)
        self._first = max(int((wall_s - _EPOCH_S) * UNITS_PER_S), stored, 1)
        self._last = self._first - 1
        self._promised = self._first + int(AHEAD_S * UNITS_PER_S)
        try:
            self._write(self._promised, dict(self._newest))
        except OSError as error:
            raise SigningTimestampsError(f"signing_stamps {path}: cannot be written ({error.strerror})") from None

    def next(self, now_s: float) -> int:
        """Return a stamp for one of our frames, greater than every earlier one."""
        self._last = max(self._first + int((now_s - self._start_s) * UNITS_PER_S), self._last + 1)
        if self._last > self._promised - AHEAD_S / 2 * UNITS_PER_S:
            self._promised = promised = self._last + int(AHEAD_S * UNITS_PER_S)
            newest = dict(self._newest)
            self._executor.submit(lambda: self._keep(promised, newest), 0.0)
        return self._last

    def is_new(self, stream: Stream, stamp: int) -> bool:
        """Return True if a frame is newer than all earlier ones of its sender.

        The frame of a new sender must not be too old.
        """
        newest = self._newest.get(stream)
        return stamp > newest if newest is not None else stamp + LATE_S * UNITS_PER_S >= self._last

    def note(self, stream: Stream, stamp: int) -> None:
        """Record the stamp of a valid frame.

        Older frames of the sender are rejected from now on, and our stamps are greater.
        """
        self._newest[stream] = stamp
        self._last = max(self._last, stamp)

    def close(self) -> None:
        """Write the stamps that were used, and none beyond them."""
        self._executor.close()
        self._keep(self._last + 1, dict(self._newest))

    def _keep(self, own: int, newest: Mapping[Stream, int]) -> None:
        try:
            self._write(own, newest)
        except OSError as error:  # the flight continues: only a crash and a wall clock set back could make an old stamp valid
            logging.getLogger(__name__).warning("%s: cannot be written (%s)", self._path, error.strerror)

    def _write(self, own: int, newest: Mapping[Stream, int]) -> None:
        tree = {"own": own, "heard": [[*stream, stamp] for stream, stamp in newest.items()]}
        # durable: a lost promise would let a start after a power loss reuse stamps
        atomic_file.replace(self._path, json.dumps(tree).encode("ascii"), durable=True)


def _read(path: Path) -> tuple[int, dict[Stream, int]]:
    """Return our first unused stamp, and the newest of each sender."""
    if not path.exists():
        return 0, {}
    try:
        tree = json.loads(path.read_text(encoding="ascii"))
        own, heard = int(tree["own"]), {(int(a), int(b), int(c)): int(stamp) for a, b, c, stamp in tree["heard"]}
    except OSError as error:
        raise SigningTimestampsError(f"signing_stamps {path}: cannot be read ({error.strerror})") from None
    except (ValueError, KeyError, TypeError):
        raise SigningTimestampsError(f"signing_stamps {path}: not the stamps of signed frames") from None
    if not all(0 <= stamp < _END for stamp in (own, *heard.values())):
        raise SigningTimestampsError(f"signing_stamps {path}: a stamp is 0 to 2**48 - 1")
    return own, heard
