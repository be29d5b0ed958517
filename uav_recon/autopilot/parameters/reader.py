"""The firmware's parameters as it tells them: numbers on the wire and what they mean, and asking for many by name."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.mavlink.messages import ParameterValue

_REAL32 = 9  # MAV_PARAM_TYPE
_INT, _FLOAT = struct.Struct("<i"), struct.Struct("<f")
WINDOW, PATIENCE_S, TRIES = 8, 0.5, 8  # questions under way; for an answer; for one parameter, with one datagram in five lost


@dataclass(frozen=True, slots=True)
class ParameterEncoding:
    """How a firmware puts values into the float of PARAM_VALUE and PARAM_SET.

    value_of: what was told; number_of: the float for a value of a MAV_PARAM_TYPE. Raises ValueError for one that it cannot
    hold.
    """

    value_of: Callable[[ParameterValue], float]
    number_of: Callable[[float, int], float]


def _from_bytes(told: ParameterValue) -> float:
    if told.kind == _REAL32:
        return told.number
    return float(_INT.unpack(_FLOAT.pack(told.number))[0])


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
NUMERIC = ParameterEncoding(lambda told: told.number, _to_number)  # ArduPilot: everything is the float that it is


def equal(a: float, b: float) -> bool:
    """Whether two values are the same to a float of 32 bits."""
    return math.isclose(a, b, rel_tol=1e-6, abs_tol=1e-9)


class ParameterReader:
    """Asks for parameters by name, a few at a time; each until it is answered or was asked in vain too often."""

    def __init__(self, names: Iterable[str]) -> None:
        self._waiting = list(names)
        self._total = len(self._waiting)
        self._asked: dict[str, tuple[int, float, ParameterValue | None]] = {}  # tries, when last, what was known before
        self.silent: list[str] = []

    @property
    def done(self) -> bool:
        """Whether nothing is asked any more."""
        return not self._waiting and not self._asked

    @property
    def progress(self) -> tuple[int, int]:
        """How many have been answered or given up, and how many there are."""
        return self._total - len(self._waiting) - len(self._asked), self._total

    def step(self, now_s: float, link: VehicleLink) -> None:
        """Take what was answered, ask what is due. The answers stand in the link's telemetry."""
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
        link.ask_parameter(now_s, name)
