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

from sitl.camera.d435i import pinhole
from sitl.faults.fault import AFTER_DISARM_S, Fault, Onset
from sitl.faults.injectors.base import ATTENDED, DepthFrame, InjectionContext, Injector, StreamedImuSample
from sitl.faults.mavlink_proxy import DelayedItems, LinkEnd, MavlinkProxy, Side
from sitl.geometry.quaternion import yaw_of
from sitl.geometry.transform import body_from_camera, world_from_body
from sitl.outside_world import CameraStreamOutput, OutsideWorld
from sitl.world.pose_tracker import PoseRecord

T = TypeVar("T")
EXTERNAL_CONTROL_MODES = ("OFFBOARD", "GUIDED")
AIRBORNE_M = 0.9
MAX_ONSET_WAIT_S = 240.0  # a flight ends after this time if no fault has begun
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


def never_split(scenario: str) -> bool:
    """Return True: the flight is not split, so every fault that begins is flown in it."""
    return True


class FaultDirector:
    """Hook of a flight that starts the faults and applies them.

    faults: one fault, or several that share the flight until their onsets. At each onset split(scenario) returns whether this
    flight is the one with that fault; if not, the flight continues with the remaining faults. The last remaining fault is flown
    without a split.
    max_onset_wait_s: the flight ends after this time if no fault has begun.
    conditions: injectors that act on the streams from boot on, before those of the fault; they are not begun or ended.
    """

    def __init__(
        self, faults: Sequence[Fault], seed: int, max_onset_wait_s: float = MAX_ONSET_WAIT_S,
        split: Callable[[str], bool] = never_split, conditions: Sequence[Injector] = (),
    ) -> None:  # fmt: skip
        self._faults = list(faults)
        self._conditions = conditions
        self._split = split
        self._injectors: Sequence[Injector] = ()
        self._longest_s = math.inf
        self._stands_s = AFTER_DISARM_S
        self._longest_wait_s = max_onset_wait_s
        self._dice = random.Random(seed * 7919 + 17)
        self._share = self._dice.random()  # position within the interval in which a fault may begin
        self._airborne_s = math.inf
        self._flown = False
        self._disarmed_s = math.inf
        self._begun_s = math.inf
        self.onset_s = math.inf
        self.end_s = -math.inf
        self.truth_samples: list[TruthSample] = []
        self.proxy: MavlinkProxy | None = None

    # -- hooks of the flight ------------------------------------------------------------------------------------------

    def enter(self, world: OutsideWorld, channels: object, now_s: float) -> None:
        """Take the finished world and insert the fault stream before its camera stream."""
        self.context = InjectionContext(world, self._dice, channels, self.proxy, now_s)
        self._begun_s = now_s
        self._stream = world.stream = FaultyStream(world.stream, self)

    def link(self, end: LinkEnd) -> MavlinkProxy:
        """Return the product's end of the MAVLink link, behind a proxy."""
        self.context.proxy = self._proxied(end, Side.PRODUCT, lambda: self.context.now_s)
        return self.context.proxy

    def autopilot_link(self, end: LinkEnd) -> MavlinkProxy:
        """Return the autopilot's end of the link, behind a proxy.

        For flights in which only that end is in this process. Call it before the world is made.
        """
        return self._proxied(end, Side.AUTOPILOT, time.monotonic)

    def _proxied(self, end: LinkEnd, side: Side, now_s: Callable[[], float]) -> MavlinkProxy:
        self.proxy = MavlinkProxy(end, side, now_s, self._fate("to_autopilot"), self._fate("to_product"))
        return self.proxy

    def turn(self, now_s: float) -> None:
        """Record the truth, start a fault that is due, and run the injectors.

        Call it in each turn before anything else moves.
        """
        at, flyer = self.context, self.context.world.flyer
        at.now_s, truth = now_s, flyer.truth()
        yaw_rad, charge = yaw_of(truth.quat_wxyz), flyer.battery_fraction
        self.truth_samples.append(TruthSample(now_s, truth.position, truth.velocity, yaw_rad, truth.armed, truth.mode, charge))
        self._watch(self.truth_samples[-1])
        for injector in self._injectors:
            injector.turn(at, now_s - self.onset_s)
        if self.proxy is not None:
            self.proxy.forward()
        self._stream.release(now_s)

    def runs(self, stage: str) -> bool:
        """Return whether the loop of a stage runs in this turn."""
        since_s = self.context.now_s - self.onset_s
        return not any(injector.stalls(since_s, stage) for injector in self._injectors)

    def restarts(self, stage: str) -> bool:
        """Return whether a stage must be rebuilt before this turn."""
        since_s = self.context.now_s - self.onset_s
        return any(injector.restarts(since_s, stage) for injector in self._injectors)

    def holds(self) -> bool:
        """Return whether the operator commands the vehicle to hold its position."""
        return self.context.hold

    def attends(self) -> bool:
        """Return whether the operator queries the status now, and note the time if so."""
        if self.context.attends:
            self.context.notes[ATTENDED] = self.context.now_s
        return self.context.attends

    def lands(self) -> bool:
        """Return whether the operator commands a landing."""
        return self.context.abort

    def over(self, finished: bool) -> bool:
        """Return whether the flight has ended; at the end, run end() of the injectors.

        finished: the mission reports that it is done.
        """
        now_s = self.context.now_s
        late = now_s - self.onset_s > self._longest_s or (
            self.onset_s == math.inf and now_s - self._begun_s > self._longest_wait_s
        )
        landed = self._flown and now_s - self._disarmed_s > self._stands_s
        ended = late or landed or (finished and not self._flown)
        if ended:
            self.end_s = now_s
            for injector in self._injectors:
                injector.end(self.context)
        return ended

    # -- onset ----------------------------------------------------------------------------------------------------------

    def _watch(self, now: TruthSample) -> None:
        self._flown = self._flown or (now.armed and now.position_m[2] > 0.3)
        self._disarmed_s = math.inf if now.armed else min(self._disarmed_s, now.stamp_s)
        if self.onset_s < math.inf:
            return
        if now.armed and now.mode in EXTERNAL_CONTROL_MODES and now.position_m[2] > AIRBORNE_M:
            self._airborne_s = min(self._airborne_s, now.stamp_s)
        for fault in [each for each in self._faults if self._onset_due(each.onset, now)]:
            if len(self._faults) == 1 or self._split(fault.scenario):
                self._begin_fault(fault, now.stamp_s)
                return
            self._faults.remove(fault)

    def _onset_due(self, onset: Onset, now: TruthSample) -> bool:
        """Return whether the onset condition is met."""
        since_s = self._begun_s if onset.at_boot else self._airborne_s
        flown = now.armed and now.mode in EXTERNAL_CONTROL_MODES
        fast = onset.at_boot or (flown and math.hypot(*now.velocity_mps[:2]) >= onset.speed_mps)
        due = fast and now.stamp_s >= since_s + onset.wait_s(self._share)
        away = math.hypot(*now.position_m[:2]) >= onset.away_m
        return due and away and (not onset.needs_view_ahead or self._looks_ahead()) and self._view_clear(onset.min_view_depth_m)

    def _looks_ahead(self) -> bool:
        """Return whether the camera looks in the direction of travel."""
        truth = self.context.world.flyer.truth()
        return off_nose_rad(truth.velocity, truth.quat_wxyz) <= _SEEN_RAD

    def _begin_fault(self, fault: Fault, now_s: float) -> None:
        """Begin this fault and drop all others."""
        self._faults = [fault]
        self.onset_s = now_s
        self._longest_s = fault.observe_s
        self._injectors = fault.injectors
        self._stands_s = fault.observe_after_disarm_s
        for injector in self._injectors:
            injector.begin(self.context)

    def _view_clear(self, clear_m: float) -> bool:
        """Return whether nothing is nearer than clear_m on the level axis before the camera."""
        if clear_m <= 0.0:
            return True
        world = self.context.world
        truth = world.flyer.truth()
        eye = world_from_body(truth.position, yaw_of(truth.quat_wxyz)) @ body_from_camera((0.0, 0.0, 0.0), 0.0)
        seen = world.camera.renderer.render(eye, _PEEK, colour=False).depth_m
        return bool(np.all((seen <= 0.0) | (seen >= clear_m)))

    # -- streams --------------------------------------------------------------------------------------------------------

    def fate(self, kind: str, item: T) -> DelayedItems[T]:
        """Return the results of passing an item through all injectors: (delay in seconds, item).

        Delays add up. kind: name of the injector method, such as "pose", "depth" or "imu".
        """
        now_s = self.context.now_s
        acting = [(injector, now_s - self._begun_s) for injector in self._conditions]
        acting += [(injector, now_s - self.onset_s) for injector in self._injectors]
        late: DelayedItems[T] = [(0.0, item)]
        for injector, since_s in acting:
            make: Callable[[float, T], DelayedItems[T]] = getattr(injector, kind)
            late = [(wait + more, changed) for wait, each in late for more, changed in make(since_s, each)]
        return late

    def _fate(self, kind: str) -> Callable[[bytes], DelayedItems[bytes]]:
        return lambda frame: self.fate(kind, frame)


class FaultyStream:
    """Camera stream that applies the faults before the real writer."""

    def __init__(self, writer: CameraStreamOutput, director: FaultDirector) -> None:
        self._writer = writer
        self._director = director
        self._waiting: list[tuple[float, int, PoseRecord | DepthFrame | StreamedImuSample]] = []
        self._numbers = itertools.count()
        self._lock = threading.Lock()  # images are rendered in a thread of their own

    def write_imu(self, stamp_s: float, gyro: NDArray[np.float64], force: NDArray[np.float64]) -> None:
        """Write an inertial sample, which the faults may delay, change or drop."""
        self._queue(self._director.fate("imu", StreamedImuSample(stamp_s, gyro, force)))

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
        self._queue(self._director.fate("pose", record))

    def write_frame(self, stamp_s: float, depth_mm: NDArray[np.uint16], rgb: NDArray[np.uint8]) -> None:
        """Write a frame, which the faults may delay, change or drop."""
        self._queue(self._director.fate("depth", DepthFrame(stamp_s, depth_mm, rgb)))

    def _queue(self, late: DelayedItems[PoseRecord] | DelayedItems[DepthFrame] | DelayedItems[StreamedImuSample]) -> None:
        now_s = self._director.context.now_s
        for wait_s, item in late:
            with self._lock:
                heapq.heappush(self._waiting, (now_s + wait_s, next(self._numbers), item))
        self.release(now_s)

    def release(self, now_s: float) -> None:
        """Write every queued item that is due."""
        while (item := self._due(now_s)) is not None:
            if isinstance(item, DepthFrame):
                self._writer.write_frame(item.stamp_s, item.depth_mm, item.rgb)
            elif isinstance(item, StreamedImuSample):
                self._writer.write_imu(item.stamp_s, item.gyro_radps, item.specific_force_mps2)
            else:
                self._writer.write_pose(
                    item.stamp_s, item.position_m, item.quat_wxyz, item.variance, item.quality, item.reset_counter
                )

    def _due(self, now_s: float) -> PoseRecord | DepthFrame | StreamedImuSample | None:
        with self._lock:
            if self._waiting and self._waiting[0][0] <= now_s + 1e-9:
                return heapq.heappop(self._waiting)[2]
        return None


def off_nose_rad(velocity: tuple[float, float, float], quat_wxyz: tuple[float, float, float, float]) -> float:
    """Return the angle, 0 to pi, between a vehicle's horizontal velocity and its heading."""
    return abs(math.remainder(math.atan2(velocity[1], velocity[0]) - yaw_of(quat_wxyz), math.tau))
