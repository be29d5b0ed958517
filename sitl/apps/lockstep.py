"""Flight in lockstep: all components in one process on a manual clock, repeatable.

The objects and the MAVLink bytes are the same as in real time; the bytes pass through a pipe in memory.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from rich.console import Console

from sitl.apps.direct_channels import direct_channels
from sitl.apps.memory_tlog import MemoryTlog
from sitl.apps.progress_display import ProgressDisplay
from sitl.apps.sim_options import SimOptions
from sitl.apps.world_process import make_world
from sitl.autopilots.byte_links import pipe
from sitl.outside_world import OutsideWorld
from sitl.scene.scene import Scene
from sitl.world.step_sizes import COARSE_STEPS, FINE_STEPS
from uav_recon.app import factory, operator_factory
from uav_recon.app.flight_channels import memory_channels
from uav_recon.app.processes import MISSION_RATE_HZ, RECORDER_RATE_HZ
from uav_recon.app.step_display import StepDisplay
from uav_recon.channels import MemoryChannel
from uav_recon.clock import InlineExecutor, ManualClock, RateKeeper
from uav_recon.config import Config
from uav_recon.interfaces import ByteLink, Mapper, Pending
from uav_recon.recording.flight_log import FlightLog
from uav_recon.recording.map_file import save_map
from uav_recon.recording.timelapse import Timelapse
from uav_recon.types.operator_command import GivenCommand
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

if TYPE_CHECKING:
    from uav_recon.recording.rerun_recorder import Recorder

T = TypeVar("T")

START_S = 1000.0
LONGEST_S = 3600.0


@dataclass(frozen=True)
class LockstepResult:
    """Result of a flight in lockstep.

    fault: one line, None without a fault. simulated_s: duration on the simulated clock. wall_s, processor_s: wall and
    processor time of the flight alone, from the first iteration to the last.
    """

    fault: str | None
    simulated_s: float
    wall_s: float
    processor_s: float


class LockstepHook(Protocol):
    """Hook into a flight in lockstep, for fault injection and measurements.

    It can act between simulator and product, and on each iteration of the product's loops.
    """

    def enter(self, world: OutsideWorld, channels: object, now_s: float) -> None:
        """Attach to the simulator and the channels, before the flight."""
        ...

    def link(self, end: ByteLink) -> ByteLink:
        """Return the product's end of the MAVLink link: the given end, or a proxy for it."""
        ...

    def turn(self, now_s: float) -> None:
        """Act at the start of an iteration."""
        ...

    def runs(self, stage: str) -> bool:
        """Return True if a stage runs in this iteration.

        Stages: pilot, perception, mission; and planner, whose calls do not return while it does not run.
        """
        ...

    def restarts(self, stage: str) -> bool:
        """Return True if a stage is restarted (created again) in this iteration."""
        ...

    def holds(self) -> bool:
        """Return True if the operator commands a hold."""
        ...

    def attends(self) -> bool:
        """Return True if the operator requests the status; called once a second."""
        ...

    def over(self, finished: bool) -> bool:
        """Return True if the flight ends here. finished: the mission is finished."""
        ...


class NoHook:
    """Hook without effect: a nominal flight without an operator."""

    def enter(self, world: OutsideWorld, channels: object, now_s: float) -> None:
        """Do nothing."""

    def link(self, end: ByteLink) -> ByteLink:
        """Return the given end."""
        return end

    def turn(self, now_s: float) -> None:
        """Do nothing."""

    def runs(self, stage: str) -> bool:
        """Return True."""
        return True

    def restarts(self, stage: str) -> bool:
        """Return False."""
        return False

    def holds(self) -> bool:
        """Return False."""
        return False

    def attends(self) -> bool:
        """Return False."""
        return False

    def over(self, finished: bool) -> bool:
        """Return True once the mission is finished."""
        return finished


NO_HOOK = NoHook()


class HookedPending(Generic[T]):
    """Pending result of the planner; not done while the hook stops the planner."""

    def __init__(self, inner: Pending[T], meddler: LockstepHook) -> None:
        self._inner = inner
        self._meddler = meddler

    def done(self) -> bool:
        """Return True if the result is available."""
        return self._meddler.runs("planner") and self._inner.done()

    def result(self) -> T:
        """Return the result of the work."""
        return self._inner.result()


class HookedExecutor:
    """Executor of the mission's planning, in which the hook can make a call hang."""

    def __init__(self, inner: InlineExecutor, meddler: LockstepHook) -> None:
        self._inner = inner
        self._meddler = meddler

    def submit(self, work: Callable[[], T], cost_s: float) -> Pending[T]:
        """Start work; its result becomes available after cost_s of simulated time."""
        return HookedPending(self._inner.submit(work, cost_s), self._meddler)

    def close(self) -> None:
        """Do nothing: work runs inline."""


def fly_in_lockstep(
    options: SimOptions, config: Config, scene: Scene, console: Console, land: Callable[[], bool], timelapse: bool = True,
    meddler: LockstepHook = NO_HOOK,
) -> LockstepResult:  # fmt: skip
    """Run a flight in lockstep and write its results to options.out.

    land: returns True if the operator wants to land now. timelapse: store states of the surface, from which recall over
    time is computed. The last argument is the hook of this flight.
    """
    clock, quick = ManualClock(START_S), options.mapper == "depth-only"
    pace, wires = (COARSE_STEPS, direct_channels()) if quick else (FINE_STEPS, memory_channels())
    ours, theirs = pipe()
    world = make_world(options.world(config.runtime.folder), scene, theirs, clock.now_s, pace)
    meddler.enter(world, wires, START_S)
    factory.warm_up(config)
    mapper = _mapper(options, config)
    log, journal = MemoryTlog(options.out / "flight.tlog"), FlightLog(options.out)
    link, executor = meddler.link(ours), HookedExecutor(InlineExecutor(clock), meddler)
    pilot = factory.make_pilot(config, wires, link, log, clock)
    perception = factory.make_perception(config, wires, clock)
    conductor = factory.make_conductor(config, wires, mapper, executor, journal, clock, time.perf_counter)
    watchers: list[Recorder | Timelapse] = []  # the recorder stores states of the surface, too
    if config.recording.rerun:
        watchers.append(factory.make_recorder(config, wires, options.out, clock))
    elif timelapse:
        watchers.append(Timelapse(options.out, wires.surface, clock))
    conductor.request_start()
    mission_rate, record_rate = RateKeeper(MISSION_RATE_HZ, START_S), RateKeeper(RECORDER_RATE_HZ, START_S)
    operator_rate, orders = RateKeeper(1.0, START_S), MemoryChannel(GivenCommand)
    steps = 0
    started_s, processor_s = time.perf_counter(), time.process_time()
    with ProgressDisplay(console, wires) as screen:
        while not meddler.over(conductor.finished) and steps * pace.iteration_s < LONGEST_S:
            steps += 1
            now_s = START_S + steps * pace.iteration_s
            clock.advance_to(now_s)
            meddler.turn(now_s)
            world.step(now_s)
            if world.frame_due(now_s):
                world.develop(world.begin_frame(now_s))
            if meddler.restarts("perception"):
                perception = factory.make_perception(config, wires, clock)
            if meddler.runs("perception"):
                perception.step()
            if meddler.restarts("mission"):
                conductor = factory.make_conductor(config, wires, mapper, executor, journal, clock, time.perf_counter)
                conductor.request_start()
            if mission_rate.due(now_s) and meddler.runs("mission"):
                if land():
                    conductor.request_abort(Reason(ReasonCode.OPERATOR_LAND))
                if meddler.holds():
                    conductor.request_hold()
                conductor.step()
            if meddler.restarts("pilot"):
                pilot = factory.make_pilot(config, wires, link, log, clock)
            if meddler.runs("pilot"):
                if operator_rate.due(now_s) and meddler.attends():
                    operator_factory.make_command_handler(wires, pilot, orders, clock).serve("status")
                pilot.step()
            if record_rate.due(now_s):
                for watcher in watchers:
                    watcher.step()
                screen.show()
        conductor.close()
    wall_s, processor_s = time.perf_counter() - started_s, time.process_time() - processor_s
    if conductor.map is not None:
        save_map(options.out, conductor.map)
    with StepDisplay(console).step("landed: training the final model and meshing"):
        mapper.finish(options.out)
    journal.refused_views(clock.now_s(), mapper.refused())
    journal.close()
    log.close()
    for watcher in watchers:
        watcher.close()
    world.truth_log.save(options.out / "truth.npz", world)
    fault = None if conductor.finished else f"the flight did not end within {LONGEST_S:.0f} s of simulated time"
    return LockstepResult(fault, steps * pace.iteration_s, wall_s, processor_s)


@contextmanager
def interrupts() -> Iterator[Callable[[], bool]]:
    """Yield a function that returns True after Ctrl-C; a second Ctrl-C ends the process at once."""
    pressed: list[int] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        pressed.append(number)
        if len(pressed) > 1:
            sys.exit(130)
        os.write(2, b"uav-recon: landing, then writing the report; press Ctrl-C again to end at once\n")

    before = signal.signal(signal.SIGINT, interrupt)
    try:
        yield lambda: bool(pressed)
    finally:
        signal.signal(signal.SIGINT, before)


def _mapper(options: SimOptions, config: Config) -> Mapper:
    """Return the mapper of the options, with its kernels compiled."""
    return {"neural": _neural, "depth-only": _depth_only}[options.mapper](config, options.out)


def _neural(config: Config, folder: Path) -> Mapper:
    from uav_recon.mapping.keyframe_store import KeyframeFolder
    from uav_recon.mapping.neural.worker.inline_mapper import InlineMapper
    from uav_recon.mapping.neural.worker.mapper_process import KEYFRAMES

    trainer = factory.make_neural_mapper(config)
    trainer.warm_up()
    return InlineMapper(trainer, config.mapper, KeyframeFolder(folder / KEYFRAMES))


def _depth_only(config: Config, folder: Path) -> Mapper:
    from sitl.apps.depth_only_mapper import DepthOnlyMapper

    return DepthOnlyMapper(config)
