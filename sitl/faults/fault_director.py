"""Fault director of a flight.

It starts the faults, applies them to every stream, and records the true state at each turn.
"""

from __future__ import annotations

import heapq
import itertools
import math
import random
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sitl.autopilots.byte_links import ByteEnd
from sitl.camera.d435i import pinhole
from sitl.faults.autopilot_side_proxy import AutopilotSideProxy
from sitl.faults.fault import STANDS_S, Fault, Onset
from sitl.faults.injectors.base import ATTENDED, Depth, InjectionContext, Injector
from sitl.faults.mavlink_proxy import Bytes, Late, Proxy, Tap
from sitl.geometry.quaternion import yaw_of
from sitl.geometry.transform import body_from_camera, world_from_body
from sitl.outside_world import Outlet, OutsideWorld
from sitl.world.pose_tracker import PoseRecord

T = TypeVar("T")
OURS = ("OFFBOARD", "GUIDED")
AIRBORNE_M = 0.9
LONGEST_WAIT_S = 240.0  # a flight ends after this time if no fault has begun
_SEEN_RAD = math.radians(25.0)  # from the heading: a person 1 m away is still in an image of 43 degrees half width

_PEEK = pinhole(16, 6, 24.0, 8.0)


@dataclass(frozen=True, slots=True)
class TruthSample:
    """True state of the vehicle at the end of one turn."""

    stamp_s: float
    position_m: tuple[float, float, float]
    velocity_mps: tuple[float, float, float]
    yaw_rad: float
    armed: bool
    mode: str
    charge: float  # state of charge, 0 to 1


def alone(row: str) -> bool:
    """Return True: the flight is not split, so every fault that begins is flown in it."""
    return True


class FaultDirector:
    """Hook of a flight that starts the faults and applies them.

    troubles: one fault, or several that share the flight until their onsets. At each onset split(row) returns whether this
    flight is the one with that fault; if not, the flight continues with the remaining faults. The last remaining fault is flown
    without a split.
    longest_wait_s: the flight ends after this time if no fault has begun.
    """

    def __init__(
        self, troubles: Sequence[Fault], seed: int, longest_wait_s: float = LONGEST_WAIT_S,
        split: Callable[[str], bool] = alone,
    ) -> None:  # fmt: skip
        self._troubles, self._split = list(troubles), split
        self._injectors: Sequence[Injector] = ()
        self._longest_s, self._stands_s, self._longest_wait_s = math.inf, STANDS_S, longest_wait_s
        self._dice = random.Random(seed * 7919 + 17)
        self._share = self._dice.random()  # position within the interval in which a fault may begin
        self._airborne_s, self._flown, self._disarmed_s = math.inf, False, math.inf
        self._begun_s = math.inf
        self.onset_s = math.inf
        self.end_s = -math.inf
        self.ledger: list[TruthSample] = []
        self.proxy: Tap | None = None

    # -- hooks of the flight ------------------------------------------------------------------------------------------

    def enter(self, world: OutsideWorld, channels: object, now_s: float) -> None:
        """Take the finished world and insert the fault stream before its camera stream."""
        self.theatre = InjectionContext(world, self._dice, channels, self.proxy, now_s)
        self._begun_s = now_s
        self._stream = world.stream = FaultyStream(world.stream, self)

    def link(self, end: Bytes) -> Proxy:
        """Return the product's end of the MAVLink link, behind a proxy."""
        proxy = Proxy(end, lambda: self.theatre.now_s, self._fate("to_autopilot"), self._fate("to_product"))
        self.proxy = self.theatre.proxy = proxy
        return proxy

    def far_link(self, end: ByteEnd) -> AutopilotSideProxy:
        """Return the autopilot's end of the link, behind a proxy.

        For flights in which only that end is in this process. Call it before the world is made.
        """
        proxy = AutopilotSideProxy(end, time.monotonic, self._fate("to_autopilot"), self._fate("to_product"))
        self.proxy = proxy
        return proxy

    def turn(self, now_s: float) -> None:
        """Record the truth, start a fault that is due, and run the injectors.

        Call it in each turn before anything else moves.
        """
        at, flyer = self.theatre, self.theatre.world.flyer
        at.now_s, truth = now_s, flyer.truth()
        yaw_rad, charge = yaw_of(truth.quat_wxyz), flyer.battery_fraction
        self.ledger.append(TruthSample(now_s, truth.position, truth.velocity, yaw_rad, truth.armed, truth.mode, charge))
        self._watch(self.ledger[-1])
        for injector in self._injectors:
            injector.turn(at, now_s - self.onset_s)
        if self.proxy is not None:
            self.proxy.forward()
        self._stream.release(now_s)

    def runs(self, stage: str) -> bool:
        """Return whether the loop of a stage runs in this turn."""
        since_s = self.theatre.now_s - self.onset_s
        return not any(injector.stalls(since_s, stage) for injector in self._injectors)

    def restarts(self, stage: str) -> bool:
        """Return whether a stage must be rebuilt before this turn."""
        since_s = self.theatre.now_s - self.onset_s
        return any(injector.restarts(since_s, stage) for injector in self._injectors)

    def holds(self) -> bool:
        """Return whether the operator commands the vehicle to hold its position."""
        return self.theatre.hold

    def attends(self) -> bool:
        """Return whether the operator queries the status now, and note the time if so."""
        if self.theatre.attends:
            self.theatre.notes[ATTENDED] = self.theatre.now_s
        return self.theatre.attends

    def lands(self) -> bool:
        """Return whether the operator commands a landing."""
        return self.theatre.abort

    def over(self, finished: bool) -> bool:
        """Return whether the flight has ended; at the end, run end() of the injectors.

        finished: the mission reports that it is done.
        """
        now_s = self.theatre.now_s
        late = now_s - self.onset_s > self._longest_s or (
            self.onset_s == math.inf and now_s - self._begun_s > self._longest_wait_s
        )
        landed = self._flown and now_s - self._disarmed_s > self._stands_s
        ended = late or landed or (finished and not self._flown)
        if ended:
            self.end_s = now_s
            for injector in self._injectors:
                injector.end(self.theatre)
        return ended

    # -- onset ----------------------------------------------------------------------------------------------------------

    def _watch(self, now: TruthSample) -> None:
        self._flown = self._flown or (now.armed and now.position_m[2] > 0.3)
        self._disarmed_s = math.inf if now.armed else min(self._disarmed_s, now.stamp_s)
        if self.onset_s < math.inf:
            return
        if now.armed and now.mode in OURS and now.position_m[2] > AIRBORNE_M:
            self._airborne_s = min(self._airborne_s, now.stamp_s)
        for trouble in [each for each in self._troubles if self._comes(each.onset, now)]:
            if len(self._troubles) == 1 or self._split(trouble.row):
                self._meet(trouble, now.stamp_s)
                return
            self._troubles.remove(trouble)

    def _comes(self, onset: Onset, now: TruthSample) -> bool:
        """Return whether the onset condition is met."""
        since_s = self._begun_s if onset.at_boot else self._airborne_s
        flown = now.armed and now.mode in OURS
        fast = onset.at_boot or (flown and math.hypot(*now.velocity_mps[:2]) >= onset.speed_mps)
        due = fast and now.stamp_s >= since_s + onset.wait_s(self._share)
        away = math.hypot(*now.position_m[:2]) >= onset.away_m
        return due and away and (not onset.seeing or self._looks_ahead()) and self._views(onset.view_m)

    def _looks_ahead(self) -> bool:
        """Return whether the camera looks in the direction of travel."""
        truth = self.theatre.world.flyer.truth()
        return off_nose_rad(truth.velocity, truth.quat_wxyz) <= _SEEN_RAD

    def _meet(self, trouble: Fault, now_s: float) -> None:
        """Begin this fault and drop all others."""
        self._troubles, self.onset_s, self._longest_s = [trouble], now_s, trouble.longest_s
        self._injectors, self._stands_s = trouble.injectors, trouble.stands_s
        for injector in self._injectors:
            injector.begin(self.theatre)

    def _views(self, clear_m: float) -> bool:
        """Return whether nothing is nearer than clear_m on the level axis before the camera."""
        if clear_m <= 0.0:
            return True
        world = self.theatre.world
        truth = world.flyer.truth()
        eye = world_from_body(truth.position, yaw_of(truth.quat_wxyz)) @ body_from_camera((0.0, 0.0, 0.0), 0.0)
        seen = world.camera.renderer.render(eye, _PEEK, colour=False).depth_m
        return bool(np.all((seen <= 0.0) | (seen >= clear_m)))

    # -- streams --------------------------------------------------------------------------------------------------------

    def fate(self, kind: str, item: T) -> Late[T]:
        """Return the results of passing an item through all injectors: (delay in seconds, item).

        Delays add up. kind: name of the injector method, such as "pose" or "depth".
        """
        since_s = self.theatre.now_s - self.onset_s
        late: Late[T] = [(0.0, item)]
        for injector in self._injectors:
            make: Callable[[float, T], Late[T]] = getattr(injector, kind)
            late = [(wait + more, changed) for wait, each in late for more, changed in make(since_s, each)]
        return late

    def _fate(self, kind: str) -> Callable[[bytes], Late[bytes]]:
        return lambda frame: self.fate(kind, frame)


class FaultyStream:
    """Camera stream that applies the faults before the real writer."""

    def __init__(self, writer: Outlet, meddler: FaultDirector) -> None:
        self._writer, self._meddler = writer, meddler
        self._waiting: list[tuple[float, int, PoseRecord | Depth]] = []
        self._numbers = itertools.count()
        self._lock = threading.Lock()  # images are rendered in a thread of their own

    def write_imu(self, stamp_s: float, gyro: NDArray[np.float64], force: NDArray[np.float64]) -> None:
        """Pass an inertial sample through unchanged."""
        self._writer.write_imu(stamp_s, gyro, force)

    def write_pose(
        self,
        stamp_s: float,
        position_m: NDArray[np.float64],
        quat_wxyz: NDArray[np.float64],
        variance: NDArray[np.float64],
        quality: int = 100,
        reset_counter: int = 0,
    ) -> None:
        """Write a pose, which the faults may delay, change or drop."""
        record = PoseRecord(stamp_s, position_m, quat_wxyz, variance, quality, reset_counter)
        self._queue(self._meddler.fate("pose", record))

    def write_frame(self, stamp_s: float, depth_mm: NDArray[np.uint16], rgb: NDArray[np.uint8]) -> None:
        """Write a frame, which the faults may delay, change or drop."""
        self._queue(self._meddler.fate("depth", Depth(stamp_s, depth_mm, rgb)))

    def _queue(self, late: Late[PoseRecord] | Late[Depth]) -> None:
        now_s = self._meddler.theatre.now_s
        for wait_s, item in late:
            with self._lock:
                heapq.heappush(self._waiting, (now_s + wait_s, next(self._numbers), item))
        self.release(now_s)

    def release(self, now_s: float) -> None:
        """Write every queued item that is due."""
        while (item := self._due(now_s)) is not None:
            if isinstance(item, Depth):
                self._writer.write_frame(item.stamp_s, item.depth_mm, item.rgb)
            else:
                self._writer.write_pose(
                    item.stamp_s, item.position_m, item.quat_wxyz, item.variance, item.quality, item.reset_counter
                )

    def _due(self, now_s: float) -> PoseRecord | Depth | None:
        with self._lock:
            if self._waiting and self._waiting[0][0] <= now_s + 1e-9:
                return heapq.heappop(self._waiting)[2]
        return None


def off_nose_rad(velocity: tuple[float, float, float], quat_wxyz: tuple[float, float, float, float]) -> float:
    """Return the angle, 0 to pi, between a vehicle's horizontal velocity and its heading."""
    return abs(math.remainder(math.atan2(velocity[1], velocity[0]) - yaw_of(quat_wxyz), math.tau))
