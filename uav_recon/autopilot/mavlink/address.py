"""MAVLink address of a program: its system and component."""

from __future__ import annotations

from typing import NamedTuple


class MavlinkAddress(NamedTuple):
    """System id and component id of a sender."""

    system: int
    component: int


# Our address. No common program uses this system id by default; MAV_GCS_SYSID of ArduPilot has to name it. The component is
# MAV_COMP_ID_ONBOARD_COMPUTER; the parameter UVR_COMP_ID of our script names it.
COMPANION_ADDRESS = MavlinkAddress(system=233, component=191)
