"""Which frames of a sender are news: links repeat frames and let some overtake others, and an old state undoes a newer one."""

from __future__ import annotations

import math

from uav_recon.autopilot.framing import kind_of

_NUMBERS = 256  # of MAVLink, then again from 0
_SILENCE_S = 0.5  # a kind not heard for so long is news whatever its number: a sender may count anew, or two share its name


class Succession:
    """Of one sender, by the sequence number of its frames; each kind of message for itself."""

    def __init__(self) -> None:
        self._newest = 0  # number of the newest frame, counted on beyond 255
        self._taken: dict[int, tuple[int, float]] = {}  # by kind: the number of the newest, and when it came

    def is_news(self, frame: bytes, now_s: float) -> bool:
        """Whether a whole MAVLink 2 frame says something newer than all of its kind before it."""
        kind, half = kind_of(frame), _NUMBERS // 2
        number = self._newest + (frame[4] - self._newest + half) % _NUMBERS - half
        self._newest = max(self._newest, number)
        newest, at_s = self._taken.get(kind, (-1, -math.inf))
        if number <= newest and now_s - at_s <= _SILENCE_S:
            return False
        self._taken[kind] = number, now_s
        return True
