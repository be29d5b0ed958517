"""Check of the vehicle's parameters before arming, repeated periodically."""

from __future__ import annotations

import math
from collections.abc import Mapping

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.mavlink.messages import ParameterValue
from uav_recon.autopilot.parameters.parameter_file import RequiredParameter
from uav_recon.autopilot.parameters.reader import ParameterEncoding, ParameterReader, equal
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_AGAIN_S = 30.0  #: internal: interval of reading the parameters back: a person at a ground station may change any of them
_FAULT_AGAIN_S = 3.0  #: internal: the same while one differs, and may be corrected


class ParameterCheck:
    """Reads back the parameters that must be met before arming, and monitors changes in flight.

    Parameters that may differ are not requested.
    """

    def __init__(self, wanted: tuple[RequiredParameter, ...], form: ParameterEncoding) -> None:
        self._wanted = tuple(one for one in wanted if one.reason.refused)
        self._form = form
        self._inquiry = self._everything()
        self._read_once = False
        self._read_s = math.inf
        self._reboots = 0
        self._checked: Mapping[str, ParameterValue] = {}
        self._changed: Reason | None = None

    def missing(self, now_s: float, link: VehicleLink) -> Reason | None:
        """Return what prevents arming, None for nothing.

        Call it every step on the ground; it never blocks.
        """
        if link.telemetry.system == 0:
            return Reason(ReasonCode.NO_AUTOPILOT_PARAMETERS)
        if link.status.reboots != self._reboots:
            self._inquiry = self._everything()
            self._read_once = False
            self._reboots = link.status.reboots
        self._inquiry.step(now_s, link)
        if not self._inquiry.done:
            self._read_s = now_s
            if not self._read_once:
                return Reason(ReasonCode.READING_PARAMETERS, self._inquiry.progress)
        self._read_once = True
        faulty = self._faulty(link)
        if self._inquiry.done and now_s - self._read_s >= (_FAULT_AGAIN_S if faulty else _AGAIN_S):
            self._inquiry = ParameterReader(one.name for one in faulty) if faulty else self._everything()
        return self._reason(faulty, link) if faulty else None

    def changed(self, link: VehicleLink) -> Reason | None:
        """Return what was changed in flight, None for nothing.

        Nothing is requested: a firmware reports a change to everybody.
        """
        if (reported := link.telemetry.parameters) != self._checked:
            self._checked = reported
            faulty = [one for one in self._faulty(link) if one.name in reported]
            self._changed = Reason(ReasonCode.PARAMETER_CHANGED, details=(self._reason(faulty, link),)) if faulty else None
        return self._changed

    def _everything(self) -> ParameterReader:
        return ParameterReader(one.name for one in self._wanted)

    def _faulty(self, link: VehicleLink) -> list[RequiredParameter]:
        return [one for one in self._wanted if not self._met(one, link)]

    def _met(self, one: RequiredParameter, link: VehicleLink) -> bool:
        reported = link.telemetry.parameters.get(one.name)
        return reported is not None and equal(self._form.value_of(reported), one.value)

    def _reason(self, faulty: list[RequiredParameter], link: VehicleLink) -> Reason:
        first = faulty[0]
        reported = link.telemetry.parameters.get(first.name)
        wanted = f"{first.value:.7g} {first.reason.unit}".rstrip()
        if reported is None:
            return Reason(ReasonCode.PARAMETER_NOT_REPORTED, (first.name, wanted, len(faulty)))
        return Reason(ReasonCode.PARAMETER_DIFFERS, (first.name, self._form.value_of(reported), wanted, len(faulty)))


class NoParameterCheck:
    """For a user who is responsible for the parameters himself."""

    def missing(self, now_s: float, link: VehicleLink) -> Reason | None:
        """Return None."""
        return None

    def changed(self, link: VehicleLink) -> Reason | None:
        """Return None."""
        return None
