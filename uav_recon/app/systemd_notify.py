"""What a service tells systemd; without NOTIFY_SOCKET (a shell, a test) nothing is told. See sd_notify(3).

Call watchdog() from a loop's progress, never from a timer thread.
"""

from __future__ import annotations

import os
import socket


def ready() -> None:
    """Start-up is over."""
    _tell("READY=1")


def watchdog() -> None:
    """The loop went round."""
    _tell("WATCHDOG=1")


def stopping() -> None:
    """The end began."""
    _tell("STOPPING=1")


def extend(seconds: float) -> None:
    """The end takes longer than the unit allows, and is not given up before so many seconds from now."""
    _tell(f"EXTEND_TIMEOUT_USEC={seconds * 1e6:.0f}")


def _tell(message: str) -> None:
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK) as pipe:
        try:
            pipe.sendto(message.encode(), "\0" + address[1:] if address.startswith("@") else address)
        except OSError:
            return  # systemd restarts or its queue is full: the next turn of the loop tells again
