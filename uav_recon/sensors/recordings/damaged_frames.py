"""Frames of a recording that can be read, and a count of those that cannot."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from uav_recon.sensors.recordings.recording import DamagedItemError, RecordingError
from uav_recon.types.camera import Frame


class DamagedFrames:
    """Frames whose images cannot be read, by number, with the cause.

    A recording may be read several times.
    """

    def __init__(self) -> None:
        self._causes: dict[int, str] = {}

    def readable(self, loaders: Iterable[tuple[int, Callable[[], Frame]]]) -> Iterator[Frame]:
        """Yield the frame of each (number, function that reads it); one that is damaged is left out.

        Raises RecordingError with the first cause if none can be read.
        """
        count, failed, first = 0, 0, ""
        for number, load in loaders:
            count += 1
            try:
                frame = load()
            except DamagedItemError as error:
                self._causes[number], first, failed = str(error), first or str(error), failed + 1
                continue
            yield frame
        if count and failed == count:
            raise RecordingError(first if count == 1 else f"none of {count} frames can be read, the first: {first}")

    def counts(self) -> tuple[tuple[str, int], ...]:
        """Return the reason and the count, for RecordingInfo.skipped; empty without one."""
        if not self._causes:
            return ()
        return ((f"damaged frames (the first: {self._causes[min(self._causes)]})", len(self._causes)),)
