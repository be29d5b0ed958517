"""Viewer window, a separate process on this machine; without it flights are still recorded."""

from __future__ import annotations

import importlib.util
import logging
import socket
import subprocess
from dataclasses import dataclass
from pathlib import Path

PORT = 9876
_HOST = "127.0.0.1"
_START_S = 10.0
_POLL_S = 0.2
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Viewer:
    """A viewer that listens on this machine."""

    port: int
    host: str = _HOST

    @property
    def address(self) -> str:
        """Address that a stream connects to."""
        return f"rerun+http://{self.host}:{self.port}/proxy"

    def alive(self) -> bool:
        """Return True if a process listens on the port. Blocks for at most a tenth of a second."""
        try:
            socket.create_connection((self.host, self.port), timeout=0.1).close()
        except OSError:
            return False
        return True


def viewer_command(*arguments: str) -> list[str]:
    """Return the command line of the installed viewer; it never listens beyond this machine.

    This is the program itself, not ``python -m rerun``, which starts it as a child that survives a kill of its parent.
    """
    found = importlib.util.find_spec("rerun_cli")
    folders = [] if found is None else list(found.submodule_search_locations or [])
    programs = [path for folder in folders for path in Path(folder).glob("rerun*") if path.name in ("rerun", "rerun.exe")]
    return [str(programs[0]) if programs else "rerun", "--bind", _HOST, *arguments]


def open_viewer(port: int = PORT, command: list[str] | None = None) -> Viewer | None:
    """Find a viewer on ``port``, or open one and wait until it listens; None if that fails.

    A failure is logged in one line. The window stays open after the flight: its user closes it. Blocks for at most ten
    seconds.
    """
    viewer = Viewer(port)
    if viewer.alive():
        return viewer
    command = viewer_command("--port", str(port)) if command is None else command
    try:
        process = subprocess.Popen(  # noqa: S603
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
    except OSError as error:
        _LOG.warning("no live view: the viewer cannot be started (%s)", error.strerror)
        return None
    for _ in range(int(_START_S / _POLL_S)):
        try:
            status = process.wait(timeout=_POLL_S)
        except subprocess.TimeoutExpired:
            if viewer.alive():
                return viewer
        else:
            _LOG.warning("no live view: the viewer ended at once with status %d (is there a display?)", status)
            return None
    process.kill()
    process.wait()
    _LOG.warning("no live view: the viewer did not listen within %.0f s", _START_S)
    return None
