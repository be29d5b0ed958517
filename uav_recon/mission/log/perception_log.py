"""Perception log: what perception rejects, written to the flight log when it changes."""

from __future__ import annotations

import math

from uav_recon.interfaces import Channel, Journal
from uav_recon.types.perception_status import PerceptionStatus

PERIOD_S = 10.0  #: internal: shortest time between two entries; a reason that is new is written at once


class PerceptionLog:
    """Writes the counts of perception when they change.

    A new reason is written at once, more of the same at most every PERIOD_S, and the last counts at the end.
    """

    def __init__(self, channel: Channel[PerceptionStatus], journal: Journal) -> None:
        self._channel = channel
        self._journal = journal
        self._written: PerceptionStatus | None = None
        self._written_s = -math.inf

    def step(self, now_s: float) -> None:
        """Write what is new."""
        newest, written = self._channel.latest(), self._written
        if newest is None:
            return
        counts, before = newest.counts(), {} if written is None else written.counts()
        moved = newest.origin is not None and (written is None or written.origin != newest.origin)
        moved |= newest.kept is not None and (written is None or written.kept is None)
        moved |= newest.correction is not None and (written is None or written.correction is None)
        remarked = set(newest.camera) > (set() if written is None else set(written.camera))
        changed = counts != before or newest.correction != (None if written is None else written.correction)
        if moved or remarked or counts.keys() - before.keys() or (changed and now_s - self._written_s >= PERIOD_S):
            self._write(newest)
            self._written_s = now_s

    def close(self) -> None:
        """Write the last counts, also if nothing was rejected."""
        newest = self._channel.latest()
        if newest is not None:
            self._write(newest)

    def _write(self, status: PerceptionStatus) -> None:
        self._journal.perception(status)
        self._written = status
