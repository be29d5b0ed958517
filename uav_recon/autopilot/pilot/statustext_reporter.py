"""Tells the people at a ground station what the pilot does and why, once for each thing it has to say."""

from __future__ import annotations

import math

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.types.reason import Reason

_APART_S = 1.0  # a mission that is refused thirty times a second is not told of thirty times


class StatusTextReporter:
    """STATUSTEXT of each new note of a flight; the newest wins where they come faster than one a second."""

    def __init__(self, link: VehicleLink) -> None:
        self._link = link
        self._said: Reason | None = None
        self._said_s = -math.inf

    def step(self, note: Reason | None, now_s: float) -> None:
        """To be called every turn of a flight with what is to be known."""
        if note == self._said or now_s - self._said_s < _APART_S:
            return
        if note is not None:
            self.say(note, now_s)
        self._said = note

    def say(self, note: Reason, now_s: float) -> None:
        """At once, also where the next note would take its place in the same turn; who says such things says few."""
        self._said, self._said_s = note, now_s
        self._link.say(now_s, note)
