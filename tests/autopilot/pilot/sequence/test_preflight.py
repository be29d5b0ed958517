"""What is named as missing before arming: a broken link first, even if it broke in this very step."""

from __future__ import annotations

import pytest
from flight_rig import ORIGIN

from uav_recon.autopilot.firmware.px4 import PX4
from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.mavlink.allow_list import AllowListFilter
from uav_recon.autopilot.mavlink.telemetry import Telemetry
from uav_recon.autopilot.mavlink.tlog import NoLog
from uav_recon.autopilot.parameters.preflight_check import NoParameterCheck
from uav_recon.autopilot.pilot.sequence.preflight import PreflightSetup
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode


class Line:
    """A byte link that can break."""

    broken = False

    def read(self) -> bytes:
        return b""

    def write(self, data: bytes) -> None:
        if self.broken:
            raise OSError(5, "Input/output error")

    def wait(self, timeout_s: float) -> None:
        pass

    def close(self) -> None:
        pass


@pytest.mark.parametrize(
    ("broken", "named"),
    [(False, Reason(ReasonCode.NO_HEARTBEAT)), (True, Reason(ReasonCode.LINK_ERROR, ("Input/output error",)))],
)
def test_a_link_that_breaks_at_the_first_request_is_named_in_the_same_step(broken: bool, named: Reason) -> None:
    line = Line()
    link = VehicleLink(line, NoLog(), 0.0, PX4, AllowListFilter())
    link.receive(0.0)
    link.telemetry = Telemetry(system=1)
    line.broken = broken
    assert PreflightSetup(link, ORIGIN, False, NoParameterCheck()).missing(0.0) == named
