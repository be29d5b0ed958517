"""Preflight setup: requests the autopilot's messages and sends the geographic origin."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.parameters.preflight_check import NoParameterCheck, ParameterCheck
from uav_recon.types.reason import Reason

_AGAIN_S = 2.0  #: internal: interval of the requests for what is missing before arming


@dataclass(frozen=True, slots=True)
class Origin:
    """The geographic position that is sent to the autopilot; indoors any position will do."""

    lat_deg: float
    lon_deg: float
    alt_m: float


class PreflightSetup:
    """Repeats the requests every two seconds while something is missing."""

    def __init__(self, link: VehicleLink, origin: Origin, gimbal: bool, parameters: ParameterCheck | NoParameterCheck) -> None:
        self._link = link
        self._origin = origin
        self._gimbal = gimbal
        self._parameters = parameters
        self._asked_s = -math.inf

    def missing(self, now_s: float) -> Reason | None:
        """Return what is missing before arming, None for nothing. Also reads the parameters back."""
        parameters = self._parameters.missing(now_s, self._link)
        t, status = self._link.telemetry, self._link.status
        missing = self._link.firmware.missing_for_arming(t, status, now_s)
        if missing and t.system != 0 and now_s - self._asked_s >= _AGAIN_S:
            self._asked_s = now_s
            self._ask(now_s)
        return (self._link.status.failure or missing) if missing else parameters  # a request may have failed just now

    @property
    def parameter_changed(self) -> Reason | None:
        """Parameter that was changed since arming, None for none."""
        return self._parameters.changed(self._link)

    def _ask(self, now_s: float) -> None:
        t, firmware = self._link.telemetry, self._link.firmware
        self._link.requests.request_streams(now_s, firmware.streams_hz)
        for identifier in () if t.version else firmware.asked_once:
            self._link.requests.request(now_s, identifier)
        if self._gimbal:
            self._link.gimbal.claim(now_s)
        if not t.readiness.origin_known and not firmware.missing_for_origin(t, self._link.status, now_s):
            self._link.send_origin(now_s, self._origin.lat_deg, self._origin.lon_deg, self._origin.alt_m)
