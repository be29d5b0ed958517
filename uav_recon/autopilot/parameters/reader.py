"""Reading of firmware parameters: encodings on the wire, and requests of many by name."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.mavlink.messages import ParameterValue

_REAL32 = 9  # MAV_PARAM_TYPE
_INT = struct.Struct("<i")
_FLOAT = struct.Struct("<f")
WINDOW = 8  # max. requests at once
PATIENCE_S = 0.5  # timeout
TRIES = 8  # tries per parameter, with one datagram in five lost


@dataclass(frozen=True, slots=True)
class ParameterEncoding:
    """Encoding of values in the float of PARAM_VALUE and PARAM_SET.

    value_of: the value of a message. number_of: the float for a value of a MAV_PARAM_TYPE; raises ValueError for one that it
    cannot hold.
    """

    value_of: Callable[[ParameterValue], float]
    number_of: Callable[[float, int], float]


def _from_bytes(reported: ParameterValue) -> float:
    if reported.kind == _REAL32:
        return reported.number
    return float(_INT.unpack(_FLOAT.pack(reported.number))[0])


def _to_bytes(value: float, kind: int) -> float:
    if kind == _REAL32:
        return value
    number: float = _FLOAT.unpack(_INT.pack(_whole(value)))[0]
    return number


def _to_number(value: float, kind: int) -> float:
    return value if kind == _REAL32 else float(_whole(value))


def _whole(value: float) -> int:
    if value != int(value) or not -(2**31) <= value < 2**31:
        raise ValueError(f"{value:g} is not a whole number of 32 bits")
    return int(value)


BYTEWISE = ParameterEncoding(_from_bytes, _to_bytes)  # PX4: the bytes of an INT32 stand where a float is expected
NUMERIC = ParameterEncoding(lambda reported: reported.number, _to_number)  # ArduPilot: every value is sent as a float


def equal(a: float, b: float) -> bool:
    """Return True if two values are equal to the precision of a 32-bit float."""
    return math.isclose(a, b, rel_tol=1e-6, abs_tol=1e-9)


class ParameterReader:
    """Requests parameters by name, a few at a time.

    Each is requested until it is answered or was requested too often.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self._waiting = list(names)
        self._total = len(self._waiting)
        self._asked: dict[str, tuple[int, float, ParameterValue | None]] = {}  # tries, last instant, value known before
        self.silent: list[str] = []

    @property
    def done(self) -> bool:
        """True if no request is left."""
        return not self._waiting and not self._asked

    @property
    def progress(self) -> tuple[int, int]:
        """Return the number answered or given up, and the total."""
        return self._total - len(self._waiting) - len(self._asked), self._total

    def step(self, now_s: float, link: VehicleLink) -> None:
        """Process answers and send due requests. The answers are in the link's telemetry."""
        for name, (tries, asked_s, before) in list(self._asked.items()):
            if link.telemetry.parameters.get(name) is not before:
                del self._asked[name]
            elif now_s - asked_s >= PATIENCE_S:
                if tries == TRIES:
                    del self._asked[name]
                    self.silent.append(name)
                else:
                    self._ask(now_s, link, name, tries + 1, before)
        while self._waiting and len(self._asked) < WINDOW:
            name = self._waiting.pop(0)
            self._ask(now_s, link, name, 1, link.telemetry.parameters.get(name))

    def _ask(self, now_s: float, link: VehicleLink, name: str, tries: int, before: ParameterValue | None) -> None:
        self._asked[name] = (tries, now_s, before)
        link.parameters.read(now_s, name)
