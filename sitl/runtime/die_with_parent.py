"""Run a program that is killed when its parent ends.

Run as `python -m sitl.runtime.die_with_parent PARENT_PID PROGRAM ARGUMENTS...`. The kernel sends SIGKILL when the parent has
ended for any reason, kill -9 included: see PR_SET_PDEATHSIG in prctl(2). The setting survives execve(2). Start it from the
parent's main thread: the kernel watches the thread that forked.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1


def die_with_parent_command(command: list[str]) -> list[str]:
    """The command line that runs a command on a leash held by this process."""
    return [sys.executable, "-m", "sitl.runtime.die_with_parent", str(os.getpid()), *command]


def main(parent: int, command: list[str]) -> None:
    """Put on the leash, and become the command. Raises OSError if either cannot be."""
    put_on(parent)
    os.execvp(command[0], command)  # noqa: S606 - our own programs


def put_on(parent: int) -> None:
    """From here on this process ends with its parent; now, if that is another one already. Raises OSError if it cannot be."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")
    if os.getppid() != parent:  # it went before the leash was on
        sys.exit(1)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])
