"""Notifications to systemd, see sd_notify(3).

Without NOTIFY_SOCKET (a shell, a test) nothing is sent. Call watchdog() from a loop's progress, never from a timer thread.
"""

from __future__ import annotations

import os
import socket


def ready() -> None:
    """Report that start-up is complete."""
    _tell("READY=1")


def watchdog() -> None:
    """Report that the loop has made a step."""
    _tell("WATCHDOG=1")


def stopping() -> None:
    """Report that the process is ending."""
    _tell("STOPPING=1")


def extend(seconds: float) -> None:
    """Extend the unit's stop timeout to at least this many seconds from now."""
    _tell(f"EXTEND_TIMEOUT_USEC={seconds * 1e6:.0f}")


def _tell(message: str) -> None:
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK) as pipe:
        try:
            pipe.sendto(message.encode(), "\0" + address[1:] if address.startswith("@") else address)
        except OSError:
            return  # systemd restarts or its queue is full: the next step of the loop sends again
