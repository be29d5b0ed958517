"""Seeing heading: the nearest in which the camera shows where the vehicle is.

For the pilot's way back from a view that does not.
"""

from __future__ import annotations

import math

from uav_recon.interfaces import LocalizabilityInterface
from uav_recon.mission.trajectory.flight_track import FlightTrack

_PERIOD_S = 0.3  #: internal: time after which it is sought again


class SeeingHeading:
    """Seeks the heading again and again.

    localizability: None if the place does not depend on the view.
    """

    def __init__(self, localizability: LocalizabilityInterface | None, track: FlightTrack, pitch_down_rad: float) -> None:
        self._localizability = localizability
        self._track = track
        self._pitch_down_rad = pitch_down_rad
        self._sought_s = -math.inf
        self._yaw_rad: float | None = None

    def yaw_rad(self, now_s: float) -> float | None:
        """Return the heading (rad, world); None if none is known."""
        if self._localizability is not None and now_s - self._sought_s >= _PERIOD_S:
            self._sought_s = now_s
            self._yaw_rad = self._localizability.seeing_yaw_rad(self._track.world_from_body, self._pitch_down_rad)
        return self._yaw_rad
