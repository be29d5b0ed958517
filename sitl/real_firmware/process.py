"""Firmware program as a child process with a log file, which ends with this process."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Mapping
from pathlib import Path

from sitl.runtime.die_with_parent import die_with_parent_command

_ROOT = Path(__file__).resolve().parents[2]
_GRACE_S = 3.0


class FirmwareError(Exception):
    """The firmware cannot fly; the message is one line."""


class FirmwareProcess:
    """Child process of a firmware, running in a given folder.

    Create it in the main thread, see sitl/runtime/die_with_parent.py. Output is written to log.
    """

    def __init__(self, command: list[str], environment: Mapping[str, str], folder: Path, log: Path) -> None:
        self._program = Path(command[0])
        self._log = log
        # the child runs in another folder and must find sitl.runtime.die_with_parent
        search = os.pathsep.join(filter(None, (str(_ROOT), os.environ.get("PYTHONPATH"))))
        with log.open("wb") as out:
            self._process = subprocess.Popen(  # noqa: S603 - the binary that the user named
                die_with_parent_command(command), cwd=folder, env={**os.environ, **environment, "PYTHONPATH": search},
                stdin=subprocess.DEVNULL, stdout=out, stderr=out,
            )  # fmt: skip

    def check(self) -> None:
        """Raise FirmwareError with the last line of output if the program has ended."""
        code = self._process.poll()
        if code is None:
            return
        ended = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        raise FirmwareError(f"{self._program.name} {ended}; its last output: {self.last_line()}")

    def last_line(self) -> str:
        """Return the last line of output, 'nothing' if none."""
        lines = [line.strip() for line in self._log.read_text(errors="replace").splitlines()]
        return next((line for line in reversed(lines) if line), "nothing")

    def close(self) -> None:
        """Terminate the program, and kill it if it does not end in time."""
        self._process.terminate()
        try:
            self._process.wait(_GRACE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
