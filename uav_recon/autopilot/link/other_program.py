"""Frames of another program with the autopilot's ids, such as a router with component id 1.

Such a program is known by its heartbeat: it is not that of an autopilot. Frames of other kinds name no sender; they are
recognised by their sequence numbers, which continue those of that heartbeat and not those of the autopilot.
"""

from __future__ import annotations

from uav_recon.autopilot.mavlink.messages import Heartbeat, Received

_NUMBERS = 256  #: internal: sequence numbers of MAVLink, which then restart at 0
#: reject: frames that continue one heartbeat of another program; a gap in the autopilot's numbers costs this many of its frames
_MAX_FOLLOWING = 4


class OtherProgramFilter:
    """Separates the frames of the autopilot from those of another program with its ids.

    Must receive every frame with these ids, in the order of arrival. What cannot be separated: a frame that the program sends
    after a lost one or more than four after its heartbeat; any frame of a program that sends no heartbeat; all frames while
    both count in step. These are taken for the autopilot's.
    """

    def __init__(self) -> None:
        self._autopilot_next = self._other_next = -1
        self._following = 0

    def is_other(self, received: Received) -> bool:
        """Return True if the frame is another program's."""
        number, message = received.frame[4], received.message
        if isinstance(message, Heartbeat) and not message.from_autopilot:
            self._other_next = (number + 1) % _NUMBERS
            self._following = _MAX_FOLLOWING
            return True
        continues = number == self._other_next and number != self._autopilot_next and self._following > 0
        if continues and not isinstance(message, Heartbeat):
            self._other_next = (number + 1) % _NUMBERS
            self._following -= 1
            return True
        self._autopilot_next = (number + 1) % _NUMBERS
        return False
