"""Map correction: detection of a new map epoch on the channel of corrections."""

from __future__ import annotations

from uav_recon.interfaces import Channel
from uav_recon.types.pose import MapCorrection


class MapCorrectionDetector:
    """Detects a new map epoch; a correction from before this mission is of another flight."""

    def __init__(self, channel: Channel[MapCorrection]) -> None:
        self._channel = channel
        self._sequence = channel.sequence()
        self._map_epoch = 0

    def detect(self) -> MapCorrection | None:
        """Return the correction to rebuild the map for, None for nothing."""
        sequence = self._channel.sequence()
        correction = self._channel.latest() if sequence != self._sequence else None
        self._sequence = sequence
        if correction is None or correction.map_epoch == self._map_epoch:
            return None
        self._map_epoch = correction.map_epoch
        return correction
