"""Which frames of a sender are news: links repeat frames and let some overtake others, and an old state undoes a newer one."""

from __future__ import annotations

import math

from uav_recon.autopilot.mavlink.framing import kind_of, payload_of

_NUMBERS = 256  # of MAVLink, then again from 0
_AGAIN_S = 1.0  # so late a copy of a frame may still come; by half of that a busy sender is half round
_SILENCE_S = 0.5  # a kind not heard for so long is news whatever its number: a sender may count anew, or two share its name


class StaleFrameFilter:
    """Of one sender: what comes again, byte for byte, and says another thing than the newest of its kind, is not. Of the rest
    the sequence number of the frames decides, each kind of message for itself.
    """

    def __init__(self) -> None:
        self._newest = 0  # number of the newest frame, counted on beyond 255
        self._heard: dict[bytes, float] = {}  # each frame of the last second, the oldest first
        self._said: dict[int, bytes] = {}  # by kind: the newest payload
        self._taken: dict[int, tuple[int, float]] = {}  # by kind: the number of the newest, and when it came

    def is_newest(self, frame: bytes, now_s: float) -> bool:
        """Whether a whole MAVLink 2 frame says something newer than all of its kind before it."""
        kind, half = kind_of(frame), _NUMBERS // 2
        if self._is_copy(frame, now_s) and payload_of(frame) != self._said[kind]:
            return False
        number = self._newest + (frame[4] - self._newest + half) % _NUMBERS - half
        self._newest = max(self._newest, number)
        newest, at_s = self._taken.get(kind, (-1, -math.inf))
        if number <= newest and now_s - at_s <= _SILENCE_S:
            return False
        self._taken[kind], self._said[kind] = (number, now_s), payload_of(frame)
        return True

    def _is_copy(self, frame: bytes, now_s: float) -> bool:
        """Whether the same was heard within the last second."""
        while self._heard and next(iter(self._heard.values())) < now_s - _AGAIN_S:
            del self._heard[next(iter(self._heard))]
        return self._heard.setdefault(frame, now_s) != now_s
