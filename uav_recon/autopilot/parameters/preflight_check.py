"""Check of the vehicle's parameters before arming, repeated periodically."""

from __future__ import annotations

import math

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.mavlink.messages import ParameterValue
from uav_recon.autopilot.parameters.parameter_file import RequiredParameter
from uav_recon.autopilot.parameters.reader import ParameterEncoding, ParameterReader, equal

_AGAIN_S, _FAULT_AGAIN_S = 30.0, 3.0  # a person at a ground station may change, or correct, any of them


class ParameterCheck:
    """Reads back the parameters that must be met before arming, and monitors changes in flight.

    Parameters that may differ are not requested.
    """

    def __init__(self, wanted: tuple[RequiredParameter, ...], form: ParameterEncoding) -> None:
        self._wanted, self._form = tuple(one for one in wanted if one.reason.refused), form
        self._inquiry = self._everything()
        self._read_once, self._read_s, self._reboots = False, math.inf, 0
        self._heeded: dict[str, ParameterValue] = {}
        self._changed = ""

    def missing(self, now_s: float, link: VehicleLink) -> str:
        """Return what prevents arming, '' for nothing.

        Call it every step on the ground; it never blocks.
        """
        t = link.telemetry
        if t.system == 0:
            return "no autopilot to read parameters from"
        if t.reboots != self._reboots:
            self._inquiry, self._read_once, self._reboots = self._everything(), False, t.reboots
        self._inquiry.step(now_s, link)
        if not self._inquiry.done:
            self._read_s = now_s
            if not self._read_once:
                return f"reading parameters back: {self._inquiry.progress}"
        self._read_once = True
        faulty = self._faulty(link)
        if self._inquiry.done and now_s - self._read_s >= (_FAULT_AGAIN_S if faulty else _AGAIN_S):
            self._inquiry = ParameterReader(one.name for one in faulty) if faulty else self._everything()
        return self._words(faulty, link) if faulty else ""

    def changed(self, link: VehicleLink) -> str:
        """Return what was changed in flight, '' for nothing.

        Nothing is requested: a firmware reports a change to everybody.
        """
        if (told := link.telemetry.parameters) != self._heeded:
            self._heeded = dict(told)
            faulty = [one for one in self._faulty(link) if one.name in told]
            self._changed = f"in flight {self._words(faulty, link)}" if faulty else ""
        return self._changed

    def _everything(self) -> ParameterReader:
        return ParameterReader(one.name for one in self._wanted)

    def _faulty(self, link: VehicleLink) -> list[RequiredParameter]:
        return [one for one in self._wanted if not self._met(one, link)]

    def _met(self, one: RequiredParameter, link: VehicleLink) -> bool:
        told = link.telemetry.parameters.get(one.name)
        return told is not None and equal(self._form.value_of(told), one.value)

    def _words(self, faulty: list[RequiredParameter], link: VehicleLink) -> str:
        first = faulty[0]
        told = link.telemetry.parameters.get(first.name)
        has = "is not told by the autopilot" if told is None else f"is {self._form.value_of(told):.7g}"
        unit = f" {first.reason.unit}" if first.reason.unit else ""
        more = f", and {len(faulty) - 1} more" if len(faulty) > 1 else ""
        return f"parameter {first.name} {has}, wanted {first.value:.7g}{unit}{more}: see uav-recon params diff"


class NoParameterCheck:
    """For a user who is responsible for the parameters himself."""

    def missing(self, now_s: float, link: VehicleLink) -> str:
        """Return ''."""
        return ""

    def changed(self, link: VehicleLink) -> str:
        """Return ''."""
        return ""
