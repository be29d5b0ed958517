"""What is named as missing before arming: a broken link first, even if it broke in this very step."""

from __future__ import annotations

import pytest
from flight_rig import ORIGIN
from px4_link import px4_link

from uav_recon.autopilot.mavlink.telemetry import Telemetry
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
    link = px4_link(line)
    link.receive(0.0)
    link.telemetry = Telemetry(system=1)
    line.broken = broken
    assert PreflightSetup(link, ORIGIN, False, NoParameterCheck()).missing(0.0) == named
