"""Live view of a flight: the stream to a viewer, which ends when the viewer does not read.

rerun waits without limit for a viewer that accepts the connection and does not read. A thread therefore checks the stream, and
shuts the connection down after a time limit; every call that waits for the viewer then returns.
"""

from __future__ import annotations

import logging
import os
import socket
import threading
from pathlib import Path
from typing import Any

from uav_recon.recording import blueprint as names
from uav_recon.recording.viewer import Viewer

_LOG = logging.getLogger(__name__)
PATIENCE_S = 5.0  # a viewer on a busy machine may need seconds, and rerun's queue holds minutes of a flight
CLOSE_TIMEOUT_S = 1.5
_CHECK_PERIOD_S = 2.0
_DISCONNECT_TIMEOUT_S = 0.5


class LiveView:
    """Stream of one flight to a viewer.

    All times are wall time: the viewer runs in real time in lockstep, too.

    stream: the rerun stream to log to while ``ended`` is False.
    ended: True once the viewer was closed or does not read.
    """

    def __init__(self, viewer: Viewer, patience_s: float = PATIENCE_S, check_period_s: float = _CHECK_PERIOD_S) -> None:
        """Connect to the viewer without waiting for it.

        patience_s: time for which the viewer may read nothing before the live view ends.
        check_period_s: interval of the checks.
        """
        import rerun as rr

        self._viewer = viewer
        self._patience_s = patience_s
        self._check_period_s = check_period_s
        self.stream: Any = rr.RecordingStream(names.APPLICATION)
        self.stream.connect_grpc(viewer.address)
        self.ended = False
        self._lock = threading.Lock()
        self._closing = threading.Event()
        threading.Thread(target=self._check_periodically, name="live view", daemon=True).start()

    def close(self) -> None:
        """Send the last values and disconnect; blocks for about two seconds at most."""
        self._closing.set()
        if self.ended:
            return
        if not self._flushed(CLOSE_TIMEOUT_S):
            self._end(CLOSE_TIMEOUT_S)
            return
        self.ended = True
        self._disconnect()

    def _check_periodically(self) -> None:
        while not self._closing.wait(self._check_period_s):
            if not self._viewer.alive() or not self._flushed(self._patience_s):
                self._end(self._patience_s)
                return

    def _flushed(self, timeout_s: float) -> bool:
        """Return True if the viewer takes everything that was logged within timeout_s."""
        try:
            self.stream.flush(timeout_sec=timeout_s)
        except RuntimeError:
            return False
        return True

    def _end(self, waited_s: float) -> None:
        """End the live view and report why, once."""
        with self._lock:
            if self.ended:
                return
            if self._viewer.alive():
                _LOG.warning("the viewer has not read for %.1f s: the live view ends, the recording is complete", waited_s)
            else:
                _LOG.warning("the live view was closed; the recording goes on")
            shut_connections(self._viewer.host, self._viewer.port)
            self.ended = True
        self._disconnect()

    def _disconnect(self) -> None:
        """Disconnect the stream; blocks for at most a second."""
        leaving = threading.Thread(target=self.stream.disconnect, daemon=True)
        leaving.start()
        leaving.join(_DISCONNECT_TIMEOUT_S)
        if leaving.is_alive():
            shut_connections(self._viewer.host, self._viewer.port)
            leaving.join(_DISCONNECT_TIMEOUT_S)


def shut_connections(host: str, port: int) -> int:
    """Shut down every TCP connection of this process to host:port, and return how many.

    rerun has no call that ends a connection without waiting for its other end.
    """
    count = 0
    for path in list(Path("/proc/self/fd").iterdir()):
        try:
            copy = os.dup(int(path.name))
        except OSError:
            continue  # closed since the listing
        try:
            connection = socket.socket(fileno=copy)
        except OSError:
            os.close(copy)  # a file
            continue
        with connection:
            try:
                if connection.getpeername()[:2] == (host, port):
                    connection.shutdown(socket.SHUT_RDWR)
                    count += 1
            except OSError:
                continue  # not connected
    return count
