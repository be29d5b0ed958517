"""The viewer's window: a process of its own on this machine; without one the flight is recorded all the same."""

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

    @property
    def address(self) -> str:
        """Where a stream connects to."""
        return f"rerun+http://{_HOST}:{self.port}/proxy"

    def alive(self) -> bool:
        """Whether somebody still listens there. Blocks for a tenth of a second at most."""
        try:
            socket.create_connection((_HOST, self.port), timeout=0.1).close()
        except OSError:
            return False
        return True


def viewer_command(*arguments: str) -> list[str]:
    """The command line of the installed viewer; it never listens beyond this machine.

    The program itself, not ``python -m rerun``: that one starts it as a child, which outlives a kill of its parent.
    """
    found = importlib.util.find_spec("rerun_cli")
    folders = [] if found is None else list(found.submodule_search_locations or [])
    programs = [path for folder in folders for path in Path(folder).glob("rerun*") if path.name in ("rerun", "rerun.exe")]
    return [str(programs[0]) if programs else "rerun", "--bind", _HOST, *arguments]


def open_viewer(port: int = PORT, command: list[str] | None = None) -> Viewer | None:
    """Find a viewer on ``port``, or open one and wait until it listens. None, and one logged line, if there is no way.

    The window outlives the flight: its user closes it. Blocks for ten seconds at most.
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
