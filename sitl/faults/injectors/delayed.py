"""Fault that begins some time after the onset of its flight, and notes when."""

from __future__ import annotations

from sitl.faults.injectors.base import DepthFrame, InjectionContext, Injector, StreamedImuSample
from sitl.faults.mavlink_proxy import DelayedItems
from sitl.world.pose_tracker import PoseRecord


class Delayed(Injector):
    """Wrapper that begins a fault wait_s after the onset and notes the time under a name.

    Until then it has no effect.
    """

    def __init__(self, injector: Injector, wait_s: float, name: str) -> None:
        self.needs = injector.needs
        self._injector = injector
        self._wait_s = wait_s
        self._name = name
        self._acts = Injector()
        self._begun_s = 0.0

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Begin the fault when it is due, and run its turn."""
        if self._acts is not self._injector and since_s >= self._wait_s:
            self._acts = self._injector
            self._begun_s = since_s
            at.notes[self._name] = at.now_s
            self._injector.begin(at)
        self._acts.turn(at, since_s - self._begun_s)

    def end(self, at: InjectionContext) -> None:
        """Undo the fault, if it has begun."""
        self._acts.end(at)

    def pose(self, since_s: float, record: PoseRecord) -> DelayedItems[PoseRecord]:
        """Return the fault's result for a pose."""
        return self._acts.pose(since_s - self._begun_s, record)

    def depth(self, since_s: float, frame: DepthFrame) -> DelayedItems[DepthFrame]:
        """Return the fault's result for a depth frame."""
        return self._acts.depth(since_s - self._begun_s, frame)

    def imu(self, since_s: float, sample: StreamedImuSample) -> DelayedItems[StreamedImuSample]:
        """Return the fault's result for an inertial sample."""
        return self._acts.imu(since_s - self._begun_s, sample)

    def to_autopilot(self, since_s: float, frame: bytes) -> DelayedItems[bytes]:
        """Return the fault's result for a MAVLink frame of the product."""
        return self._acts.to_autopilot(since_s - self._begun_s, frame)

    def to_product(self, since_s: float, frame: bytes) -> DelayedItems[bytes]:
        """Return the fault's result for a MAVLink frame of the autopilot."""
        return self._acts.to_product(since_s - self._begun_s, frame)

    def stalls(self, since_s: float, stage: str) -> bool:
        """Return whether the fault stalls the stage."""
        return self._acts.stalls(since_s - self._begun_s, stage)

    def restarts(self, since_s: float, stage: str) -> bool:
        """Return whether the fault restarts the stage."""
        return self._acts.restarts(since_s - self._begun_s, stage)
