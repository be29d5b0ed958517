"""Second copy of this program: a frame with our own ids that only it sends."""

from __future__ import annotations

from uav_recon.autopilot.mavlink.framing import kind_of
from uav_recon.autopilot.mavlink.messages import Heartbeat, Received

_FLYING_KINDS = (84, 331)  #: refuse: SET_POSITION_TARGET_LOCAL_NED or ODOMETRY with our ids: another program flies with them


def from_second_copy(received: Received) -> bool:
    """Return True if a frame with our own ids comes from a second copy of this program.

    Any other program gives False. A copy is known by its heartbeat, which is that of a companion, and by its setpoints and
    poses.
    """
    message = received.message
    return (isinstance(message, Heartbeat) and message.from_companion) or kind_of(received.frame) in _FLYING_KINDS
