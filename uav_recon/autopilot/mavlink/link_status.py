"""Status of the link to one vehicle, as a frozen value: clock, senders, delays, faults."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

DUPLICATE_AUTOPILOT = Reason(ReasonCode.TWO_AUTOPILOTS)


@dataclass(frozen=True, slots=True)
class LinkStatus:
    """State of the link at one moment. Instants are on our clock; -inf = never."""

    time_known: bool = False  # the autopilot's clock is known
    reboots: int = 0
    clock_answers: int = 0  # prompt answers to its requests for our clock
    pose_fed_s: float = -math.inf
    stale_frames: int = 0  # repeated, or overtaken by newer ones
    slow: Reason | None = None  # our messages are too late: the lag uses up the clearance of planned paths
    own_id_in_use: bool = False  # another sender uses our own id
    identity_fault: Reason | None = None  # why the autopilot that answers is not the one that is flown
    duplicate_autopilot: bool = False  # two autopilots use its id: their messages cannot be distinguished
    failure: Reason | None = None  # why the byte link failed last

    @property
    def duplicate_fault(self) -> Reason | None:
        """Reason for which two autopilots cannot be flown, None while there is one."""
        return DUPLICATE_AUTOPILOT if self.duplicate_autopilot else None

    @property
    def autopilot_fault(self) -> Reason | None:
        """Reason not to trust that the messages come from the autopilot that is flown, or None."""
        return self.identity_fault or self.duplicate_fault
