"""Detection of two autopilots with one id: two boot clocks at once, or an alternating mode.

It does not sort frames: only a signature can show which sender is right. A link that delays, repeats or shuffles frames by
half a second counts as one autopilot, and so does an autopilot that restarts: its old clock falls silent.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

from uav_recon.autopilot.firmware.profile import FirmwareProfile
from uav_recon.autopilot.mavlink.framing import kind_of, payload_of
from uav_recon.autopilot.mavlink.messages import Heartbeat, Received

_STAMPED = (31, 32)  #: internal: ids of ATTITUDE_QUATERNION and LOCAL_POSITION_NED, which begin with milliseconds since boot
_WRAP_S = 2.0**32 / 1000.0  #: internal: a boot clock of 32 bits restarts after this
_APART_S = 0.8  #: hold: boot clocks farther apart are two autopilots: frames of one are at most half a second late
_LIVED_S = 0.6  #: hold: a second boot clock counts after this time: a restart mixes frames for less
_SILENT_S = 0.4  #: hold: a boot clock that is silent for longer no longer counts
_MAX_CLOCKS = 3  #: hold: more boot clocks than this are several autopilots, however young the clocks are
_CHANGES = 6  #: hold: this many mode changes within _WITHIN_S: frames that are 0.3 s late make five of one switch
_WITHIN_S = 3.0  #: hold: time within which _CHANGES count together
_AGAIN_S = 1.0  #: internal: a heartbeat repeated within this time is a copy, and no change of mode
_CALM_S = 2.0  #: hold: ends this long after the last sign of a second autopilot
_RECENT_S = 0.25  #: internal: a reported mode is current for this time: a vehicle reports it ten times a second


@dataclass(slots=True)
class _BootClock:
    """A boot clock. ahead_s: its lead over our clock, by its newest frame."""

    ahead_s: float
    first_s: float
    received_s: float


class DuplicateAutopilotDetector:
    """Must receive every frame of the vehicle's autopilot, before any is filtered out."""

    def __init__(self) -> None:
        self._clocks: list[_BootClock] = []
        self._copies: dict[bytes, float] = {}  # heartbeats of the last second
        self._state: tuple[bool, int] | None = None
        self._changed_s: deque[float] = deque(maxlen=_CHANGES)
        self._received_s: dict[tuple[bool, int], float] = {}
        self._seen_s = -math.inf

    def update(self, received: Received, now_s: float) -> None:
        """Check one frame that the allow list admits."""
        if isinstance(received.message, Heartbeat):
            self._check_state(received.message, received.frame, now_s)
        elif kind_of(received.frame) in _STAMPED:
            self._check_clock(int.from_bytes(payload_of(received.frame)[:4], "little") / 1000.0 - now_s, now_s)

    def detected(self, now_s: float) -> bool:
        """Return True if there are two, now or within the last two seconds."""
        return now_s - self._seen_s <= _CALM_S

    def recent_states(self, now_s: float) -> list[tuple[bool, int]]:
        """Return (armed, mode) of the heartbeats of the last quarter second.

        There is more than one entry if they contradict each other or change.
        """
        return [state for state, at_s in self._received_s.items() if now_s - at_s < _RECENT_S]

    def _check_clock(self, ahead_s: float, now_s: float) -> None:
        self._clocks = [clock for clock in self._clocks if now_s - clock.received_s <= _SILENT_S]
        mine = [clock for clock in self._clocks if abs(math.remainder(clock.ahead_s - ahead_s, _WRAP_S)) <= _APART_S]
        if mine:
            mine[0].ahead_s, mine[0].received_s = ahead_s, now_s
        else:
            self._clocks.append(_BootClock(ahead_s, now_s, now_s))
        settled = sum(now_s - clock.first_s >= _LIVED_S for clock in self._clocks)
        if settled > 1 or len(self._clocks) > _MAX_CLOCKS:
            self._clocks = self._clocks[-_MAX_CLOCKS:]
            self._seen_s = now_s

    def _check_state(self, message: Heartbeat, frame: bytes, now_s: float) -> None:
        state = message.armed, message.custom_mode
        self._received_s = {recent: self._received_s[recent] for recent in self.recent_states(now_s)} | {state: now_s}
        self._copies = {old: at_s for old, at_s in self._copies.items() if now_s - at_s <= _AGAIN_S}
        if self._copies.setdefault(frame, now_s) != now_s:
            return
        if self._state not in (None, state):
            self._changed_s.append(now_s)
            if len(self._changed_s) == _CHANGES and now_s - self._changed_s[0] <= _WITHIN_S:
                self._seen_s = now_s
        self._state = state


def resolved(
    message: Heartbeat, states: list[tuple[bool, int]], duplicate: bool, firmware: FirmwareProfile
) -> Heartbeat | None:
    """Return the heartbeat that is used where states (armed, mode) contradict each other.

    None if the message is not used.
    The motors count as off only when no current heartbeat reports them running. With two autopilots (duplicate), a mode that is
    not ours has precedence over ours, so that a human pilot always wins, and ours over a landing, so that no sender can keep us
    from requesting one.
    """
    armed = [mode for runs, mode in states if runs]
    if armed and not message.armed:
        return None
    if not duplicate:
        return message
    modes = armed or [message.custom_mode]
    mode = min(modes, key=lambda mode: firmware.is_ours(mode) + 2 * firmware.is_landing(mode))
    return replace(message, custom_mode=mode)
