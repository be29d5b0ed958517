"""Whether a child process still gets on: it is asked in turn, and what it was given of the processor is watched meanwhile."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

LOOK_S = 0.5
ASLEEP_S = 3.0  # owes an answer, is neither running nor waiting for a core or a disk, and uses no processor time
SILENT_S = 60.0  # owes an answer, whatever it does meanwhile
_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")
_AT_REST = "STt"  # sleeping and stopped: proc_pid_stat(5); a starved process is R, one that waits for a disk D


@dataclass(frozen=True, slots=True)
class ProcessActivity:
    """processor_s that a process has used so far; whether it sleeps or was stopped."""

    processor_s: float
    at_rest: bool


def activity_of(pid: int) -> ProcessActivity | None:
    """Of a process and all its threads; None if it is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return None
    return ProcessActivity((int(fields[11]) + int(fields[12])) * _TICK_S, fields[0] in _AT_REST)


class ChildWatchdog:
    """One child's. asked() and answered() as it happens; hung() now and then. Seconds are of any one clock."""

    def __init__(self) -> None:
        self._asked_s: float | None = None
        self._used_s, self._awake_s = -1.0, 0.0

    @property
    def owes(self) -> bool:
        """Whether an answer is outstanding."""
        return self._asked_s is not None

    def asked(self, now_s: float) -> None:
        """The child was asked."""
        self._asked_s = self._awake_s = now_s

    def answered(self) -> None:
        """It answered."""
        self._asked_s = None

    def hung(self, now_s: float, pulse: ProcessActivity | None, patient: bool) -> bool:
        """Whether to give it up. patient: it compiles or learns a whole flight, so silence alone means nothing."""
        if pulse is None or self._asked_s is None:
            return False
        if not pulse.at_rest or pulse.processor_s > self._used_s:
            self._awake_s = now_s
        self._used_s = pulse.processor_s
        return now_s - self._awake_s > ASLEEP_S or (not patient and now_s - self._asked_s > SILENT_S)
