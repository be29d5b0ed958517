"""Filter for old frames of a sender.

Links repeat frames and let some overtake others; an old state must not replace a newer one.
"""

from __future__ import annotations

import math

from uav_recon.autopilot.mavlink.framing import kind_of, payload_of

_NUMBERS = 256  #: internal: sequence numbers of MAVLink, which then restart at 0
#: reject: a copy of an old frame within this time; in half of it a busy sender passes half of the sequence numbers
_AGAIN_S = 1.0
#: reject: a frame with an old number; after this silence any is accepted: a sender may have restarted, or two share an id
_SILENCE_S = 0.5


class StaleFrameFilter:
    """Filters the frames of one sender.

    A byte-identical copy is stale if the newest frame of its kind has another payload. Otherwise the sequence number decides,
    separately for each kind of message.
    """

    def __init__(self) -> None:
        self._newest = 0  # number of the newest frame, counted on beyond 255
        self._heard: dict[bytes, float] = {}  # each frame of the last second, oldest first
        self._said: dict[int, bytes] = {}  # by kind: the newest payload
        self._taken: dict[int, tuple[int, float]] = {}  # by kind: the number of the newest, and when it came

    def is_newest(self, frame: bytes, now_s: float) -> bool:
        """Return True if a whole MAVLink 2 frame is newer than all of its kind before it."""
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
        """Return True if the same frame was received within the last second."""
        while self._heard and next(iter(self._heard.values())) < now_s - _AGAIN_S:
            del self._heard[next(iter(self._heard))]
        return self._heard.setdefault(frame, now_s) != now_s
