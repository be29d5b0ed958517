"""Run a program that is killed when its parent ends.

Run as `python -m sitl.runtime.die_with_parent PARENT_PID PROGRAM ARGUMENTS...`. The kernel sends SIGKILL when the parent
ends for any reason, kill -9 included: see PR_SET_PDEATHSIG in prctl(2). The setting survives execve(2). Start it from the
parent's main thread: the signal is sent when the thread that forked ends.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1


def die_with_parent_command(command: list[str]) -> list[str]:
    """Return the command line that runs a command which is killed when this process ends."""
    return [sys.executable, "-m", "sitl.runtime.die_with_parent", str(os.getpid()), *command]


def main(parent: int, command: list[str]) -> None:
    """Run the command in place of this process, to be killed when its parent ends.

    Raises OSError if the kernel refuses or the command cannot be started.
    """
    set_parent_death_signal(parent)
    os.execvp(command[0], command)  # noqa: S606 - our own programs


def set_parent_death_signal(parent: int) -> None:
    """Kill this process when its parent ends; exit at once if the parent is another one already.

    Raises OSError if the kernel refuses.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl(PR_SET_PDEATHSIG)")
    if os.getppid() != parent:  # the parent ended before prctl took effect
        sys.exit(1)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2:])
