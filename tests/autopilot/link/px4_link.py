"""A link to PX4 over a byte link of a test."""

from __future__ import annotations

from uav_recon.autopilot.firmware.px4 import PX4
from uav_recon.autopilot.link.frame_exchange import FrameExchange
from uav_recon.autopilot.link.vehicle_link import VehicleLink
from uav_recon.autopilot.mavlink.allow_list import AllowListFilter
from uav_recon.autopilot.mavlink.tlog import NoLog
from uav_recon.interfaces import ByteLink


def px4_link(bytes_link: ByteLink, allow_list: AllowListFilter | None = None) -> VehicleLink:
    """Return a link that starts at 0 s and records nothing. allow_list: None: that of system 1."""
    allow_list = allow_list or AllowListFilter()
    return VehicleLink(FrameExchange(bytes_link, NoLog(), allow_list.seal), allow_list, PX4, 0.0)
