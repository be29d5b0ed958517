"""STATUSTEXT reporter: sends each new note of the pilot once to the ground station."""

from __future__ import annotations

import math

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.types.reason import Reason

_APART_S = 1.0  #: warn: at most one message in this time: a mission that is refused thirty times a second causes one


class StatusTextReporter:
    """Sends STATUSTEXT for each new note of a flight; of several within a second, the newest."""

    def __init__(self, link: VehicleLink) -> None:
        self._link = link
        self._said: Reason | None = None
        self._said_s = -math.inf

    def step(self, note: Reason | None, now_s: float) -> None:
        """Send the note if it is new. Call it every step of a flight."""
        if note == self._said or now_s - self._said_s < _APART_S:
            return
        if note is not None:
            self.say(note, now_s)
        self._said = note

    def say(self, note: Reason, now_s: float) -> None:
        """Send at once, even if another note follows in the same step; meant for rare messages."""
        self._said = note
        self._said_s = now_s
        self._link.say(now_s, note)
