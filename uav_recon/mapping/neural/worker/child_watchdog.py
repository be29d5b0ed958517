"""Watchdog of a child process: checks that it answers requests or uses processor time."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

CHECK_PERIOD_S = 0.5
IDLE_TIMEOUT_S = 3.0  # timeout of an unanswered request while the child sleeps and uses no processor time
RESPONSE_TIMEOUT_S = 60.0  # timeout of an unanswered request in any state
_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")
_AT_REST = "STt"  # sleeping or stopped, see proc_pid_stat(5); a starved process is in state R, one waiting for a disk in D


@dataclass(frozen=True, slots=True)
class ProcessActivity:
    """Processor time used by a process (processor_s), and whether it sleeps or is stopped."""

    processor_s: float
    at_rest: bool


def activity_of(pid: int) -> ProcessActivity | None:
    """Return the activity of a process with all its threads; None if the process is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return None
    return ProcessActivity((int(fields[11]) + int(fields[12])) * _TICK_S, fields[0] in _AT_REST)


class ChildWatchdog:
    """Watchdog of one child.

    Call asked() and answered() on each request and answer, and is_hung() periodically. Times in seconds of any one clock.
    """

    def __init__(self) -> None:
        self._asked_s: float | None = None
        self._used_s = -1.0
        self._awake_s = 0.0

    @property
    def answer_pending(self) -> bool:
        """True while an answer is outstanding."""
        return self._asked_s is not None

    def asked(self, now_s: float) -> None:
        """Record that a request was sent to the child."""
        self._asked_s = self._awake_s = now_s

    def answered(self) -> None:
        """Record that the child answered."""
        self._asked_s = None

    def is_hung(self, now_s: float, activity: ProcessActivity | None, patient: bool) -> bool:
        """Return True if the child hangs.

        patient: the child compiles or learns a whole flight, so a missing answer alone is no sign of a hang.
        """
        if activity is None or self._asked_s is None:
            return False
        if not activity.at_rest or activity.processor_s > self._used_s:
            self._awake_s = now_s
        self._used_s = activity.processor_s
        return now_s - self._awake_s > IDLE_TIMEOUT_S or (not patient and now_s - self._asked_s > RESPONSE_TIMEOUT_S)
