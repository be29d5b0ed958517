"""A trouble that begins a little later than the moment of its flight, and says when that was."""

from __future__ import annotations

from sitl.faults.injectors.base import Depth, InjectionContext, Injector
from sitl.faults.mavlink_proxy import Late
from sitl.world.pose_tracker import PoseRecord


class Delayed(Injector):
    """wait_s after the moment the trouble has its own, which is noted under a name; until then there is none."""

    def __init__(self, trouble: Injector, wait_s: float, name: str) -> None:
        self.needs = trouble.needs
        self._trouble, self._wait_s, self._name = trouble, wait_s, name
        self._acts, self._begun_s = Injector(), 0.0

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Begin, once it is time."""
        if self._acts is not self._trouble and since_s >= self._wait_s:
            self._acts, self._begun_s, at.notes[self._name] = self._trouble, since_s, at.now_s
            self._trouble.begin(at)
        self._acts.turn(at, since_s - self._begun_s)

    def end(self, at: InjectionContext) -> None:
        """What never began leaves nothing behind."""
        self._acts.end(at)

    def pose(self, since_s: float, record: PoseRecord) -> Late[PoseRecord]:
        """As the trouble has it."""
        return self._acts.pose(since_s - self._begun_s, record)

    def depth(self, since_s: float, frame: Depth) -> Late[Depth]:
        """As the trouble has it."""
        return self._acts.depth(since_s - self._begun_s, frame)

    def to_autopilot(self, since_s: float, frame: bytes) -> Late[bytes]:
        """As the trouble has it."""
        return self._acts.to_autopilot(since_s - self._begun_s, frame)

    def to_product(self, since_s: float, frame: bytes) -> Late[bytes]:
        """As the trouble has it."""
        return self._acts.to_product(since_s - self._begun_s, frame)

    def stalls(self, since_s: float, stage: str) -> bool:
        """As the trouble has it."""
        return self._acts.stalls(since_s - self._begun_s, stage)

    def restarts(self, since_s: float, stage: str) -> bool:
        """As the trouble has it."""
        return self._acts.restarts(since_s - self._begun_s, stage)
