"""Faults of the companion computer: hung or dead stages, an operator's abort, a full disk."""

from __future__ import annotations

import resource

from sitl.faults.injectors.base import Capabilities, InjectionContext, Injector


class Stall(Injector):
    """Stages that do not run for for_s, as under SIGSTOP; by default for ever, as under SIGKILL.

    The stage "planner" is a planner call that does not return, in a mission that runs.
    """

    needs = Capabilities.STAGES

    def __init__(self, *stages: str, for_s: float = 1e9) -> None:
        self._stages = stages
        self._for_s = for_s

    def stalls(self, since_s: float, stage: str) -> bool:
        """Return True for the given stages until for_s."""
        return stage in self._stages and since_s < self._for_s


class Crash(Injector):
    """A stage that dies and is rebuilt by its supervisor after back_s."""

    needs = Capabilities.STAGES

    def __init__(self, stage: str, back_s: float) -> None:
        self._stage = stage
        self._back_s = back_s
        self._restarted = False

    def stalls(self, since_s: float, stage: str) -> bool:
        """Return True for the stage until back_s."""
        return stage == self._stage and since_s < self._back_s

    def restarts(self, since_s: float, stage: str) -> bool:
        """Return True once, at back_s."""
        if stage != self._stage or since_s < self._back_s or self._restarted:
            return False
        self._restarted = True
        return True


class Abort(Injector):
    """The operator commands a landing with the abort key."""

    needs = Capabilities.STAGES

    def begin(self, at: InjectionContext) -> None:
        """Press the key."""
        at.abort = True


class HostilePlannerMarker(Injector):
    """A hostile planner.

    This class only marks it: the code that flies the scenario adds the hostile planner.
    """

    needs = Capabilities.STAGES


class FileSizeLimit(Injector):
    """Limit on the size of every file that this process writes, in bytes.

    Writes fail with an OSError, as on a full disk. Root is not needed.
    """

    needs = Capabilities.STAGES

    def __init__(self, max_bytes: int = 4096, for_s: float = 1e9) -> None:
        self._max_bytes = max_bytes
        self._for_s = for_s
        self._before = (-1, -1)

    def begin(self, at: InjectionContext) -> None:
        """Set the limit, for this process only."""
        self._before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (self._max_bytes, self._before[1]))

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Remove the limit after for_s, or once the motors have stopped.

        Then the simulator must be able to write its own files.
        """
        if since_s > self._for_s or (since_s > 1.0 and not at.world.flyer.truth().armed):
            self.end(at)

    def end(self, at: InjectionContext) -> None:
        """Restore the previous limit."""
        resource.setrlimit(resource.RLIMIT_FSIZE, self._before)
