"""Troubles of the companion itself: stages that stand still or die, an operator's key, a disk that takes no more."""

from __future__ import annotations

import resource

from sitl.faults.injectors.base import Capabilities, InjectionContext, Injector


class Stall(Injector):
    """Stages stand still for a while, as under SIGSTOP; for ever by default, as under SIGKILL. The stage planner is a call
    that does not return, in a mission that runs.
    """

    needs = Capabilities.STAGES

    def __init__(self, *stages: str, for_s: float = 1e9) -> None:
        self._stages, self._for_s = stages, for_s

    def stalls(self, since_s: float, stage: str) -> bool:
        """Within the time."""
        return stage in self._stages and since_s < self._for_s


class Crash(Injector):
    """A stage dies and is built anew by its supervisor after back_s."""

    needs = Capabilities.STAGES

    def __init__(self, stage: str, back_s: float) -> None:
        self._stage, self._back_s, self._restarted = stage, back_s, False

    def stalls(self, since_s: float, stage: str) -> bool:
        """Until it is back."""
        return stage == self._stage and since_s < self._back_s

    def restarts(self, since_s: float, stage: str) -> bool:
        """Once."""
        if stage != self._stage or since_s < self._back_s or self._restarted:
            return False
        self._restarted = True
        return True


class Abort(Injector):
    """The operator's one key."""

    needs = Capabilities.STAGES

    def begin(self, at: InjectionContext) -> None:
        """Pressed."""
        at.abort = True


class Madness(Injector):
    """The planner itself: whoever flies the row puts a hostile one in its place."""

    needs = Capabilities.STAGES


class DiskFull(Injector):
    """No file grows beyond so many bytes any more: what a full disk says too (an OSError on write), without root."""

    needs = Capabilities.STAGES

    def __init__(self, max_bytes: int = 4096, for_s: float = 1e9) -> None:
        self._max_bytes, self._for_s, self._before = max_bytes, for_s, (-1, -1)

    def begin(self, at: InjectionContext) -> None:
        """Of this process alone."""
        self._before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (self._max_bytes, self._before[1]))

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Space again after the time, or when the motors have stopped: the referee must write too."""
        if since_s > self._for_s or (since_s > 1.0 and not at.world.flyer.truth().armed):
            self.end(at)

    def end(self, at: InjectionContext) -> None:
        """As it was."""
        resource.setrlimit(resource.RLIMIT_FSIZE, self._before)
