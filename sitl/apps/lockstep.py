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
from sitl.apps.flight_config import world_options
from sitl.apps.memory_tlog import MemoryTlog
from sitl.apps.progress_display import ProgressDisplay
from sitl.apps.sim_options import SimOptions
from sitl.apps.world_process import make_world
from sitl.autopilots.byte_links import PipeEnd, pipe
from sitl.outside_world import OutsideWorld
from sitl.scene.scene import Scene
from sitl.world.step_sizes import COARSE_STEPS, FINE_STEPS
from uav_recon.app import mapper_factory, mission_factory, operator_factory, perception_factory, pilot_factory, recorder_factory
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
    from uav_recon.autopilot.pilot.pilot import Pilot
    from uav_recon.mission.conductor import Conductor
    from uav_recon.recording.rerun_recorder import RerunRecorder

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

    def link(self, end: PipeEnd) -> ByteLink:
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

    def __init__(self, inner: Pending[T], hook: LockstepHook) -> None:
        self._inner = inner
        self._hook = hook

    def done(self) -> bool:
        """Return True if the result is available."""
        return self._hook.runs("planner") and self._inner.done()

    def result(self) -> T:
        """Return the result of the work."""
        return self._inner.result()


class HookedExecutor:
    """Executor of the mission's planning, in which the hook can make a call hang."""

    def __init__(self, inner: InlineExecutor, hook: LockstepHook) -> None:
        self._inner = inner
        self._hook = hook

    def submit(self, work: Callable[[], T], cost_s: float) -> Pending[T]:
        """Start work; its result becomes available after cost_s of simulated time."""
        return HookedPending(self._inner.submit(work, cost_s), self._hook)

    def close(self) -> None:
        """Do nothing: work runs inline."""


class LockstepFlight:
    """The components of one flight on one manual clock; step() runs one iteration of all loops."""

    def __init__(self, options: SimOptions, config: Config, scene: Scene, hook: LockstepHook, timelapse: bool) -> None:
        quick = options.mapper == "depth-only"
        self._config = config
        self._folder = options.folder
        self._hook = hook
        self._clock = ManualClock(START_S)
        self._pace, self.channels = (COARSE_STEPS, direct_channels()) if quick else (FINE_STEPS, memory_channels())
        ours, theirs = pipe()
        self._world = make_world(world_options(options, config.runtime.folder), scene, theirs, self._clock.now_s, self._pace)
        hook.enter(self._world, self.channels, START_S)
        mission_factory.warm_up(config)
        self._mapper = _mapper(options, config)
        self._tlog, self._journal = MemoryTlog(self._folder / "flight.tlog"), FlightLog(self._folder)
        self._link, self._executor = hook.link(ours), HookedExecutor(InlineExecutor(self._clock), hook)
        self._pilot = self._make_pilot()
        self._perception = perception_factory.make_perception(config, self.channels, self._clock)
        self.conductor = self._make_conductor()
        self._watchers: list[RerunRecorder | Timelapse] = []  # the recorder stores states of the surface, too
        if config.recording.rerun:
            self._watchers.append(recorder_factory.make_recorder(config, self.channels, self._folder, self._clock))
        elif timelapse:
            self._watchers.append(Timelapse(self._folder, self.channels.surface, self._clock))
        self.conductor.requests.start()
        self._mission_rate, self._record_rate = RateKeeper(MISSION_RATE_HZ, START_S), RateKeeper(RECORDER_RATE_HZ, START_S)
        self._operator_rate, self._commands = RateKeeper(1.0, START_S), MemoryChannel(GivenCommand)
        self._steps = 0

    @property
    def simulated_s(self) -> float:
        """Simulated time since the start."""
        return self._steps * self._pace.iteration_s

    def step(self, land: Callable[[], bool], screen: ProgressDisplay) -> None:
        """Run one iteration: simulator, perception, mission, pilot, recorders."""
        self._steps += 1
        now_s = START_S + self.simulated_s
        self._clock.advance_to(now_s)
        self._hook.turn(now_s)
        self._step_world(now_s)
        self._step_perception()
        self._step_mission(now_s, land)
        self._step_pilot(now_s)
        if self._record_rate.due(now_s):
            for watcher in self._watchers:
                watcher.step()
            screen.show()

    def save(self, console: Console) -> None:
        """Train the final model and write all results of the flight."""
        self._perception.close()
        if self.conductor.map is not None:
            save_map(self._folder, self.conductor.map)
        with StepDisplay(console).step("landed: training the final model and meshing"):
            self._mapper.finish(self._folder)
        self._journal.refused_views(self._clock.now_s(), self._mapper.refused())
        self._journal.close()
        self._tlog.close()
        for watcher in self._watchers:
            watcher.close()
        self._world.truth_log.save(self._folder / "truth.npz", self._world)

    def _step_world(self, now_s: float) -> None:
        self._world.step(now_s)
        if self._world.frame_due(now_s):
            self._world.develop(self._world.begin_frame())

    def _step_perception(self) -> None:
        if self._hook.restarts("perception"):
            self._perception = perception_factory.make_perception(self._config, self.channels, self._clock)
        if self._hook.runs("perception"):
            self._perception.step()

    def _step_mission(self, now_s: float, land: Callable[[], bool]) -> None:
        if self._hook.restarts("mission"):
            self.conductor = self._make_conductor()
            self.conductor.requests.start()
        if self._mission_rate.due(now_s) and self._hook.runs("mission"):
            if land():
                self.conductor.requests.abort(Reason(ReasonCode.OPERATOR_LAND))
            if self._hook.holds():
                self.conductor.requests.hold()
            self.conductor.step(now_s)

    def _step_pilot(self, now_s: float) -> None:
        if self._hook.restarts("pilot"):
            self._pilot = self._make_pilot()
        if self._hook.runs("pilot"):
            if self._operator_rate.due(now_s) and self._hook.attends():
                operator_factory.make_command_handler(self.channels, self._pilot, self._commands, self._clock).serve("status")
            self._pilot.step()

    def _make_pilot(self) -> Pilot:
        return pilot_factory.make_pilot(self._config, self.channels, self._link, self._tlog, self._clock)

    def _make_conductor(self) -> Conductor:
        return mission_factory.make_conductor(
            self._config, self.channels, self._mapper, self._executor, self._journal, time.perf_counter
        )


def fly_in_lockstep(
    options: SimOptions, config: Config, scene: Scene, console: Console, land: Callable[[], bool], timelapse: bool = True,
    hook: LockstepHook = NO_HOOK,
) -> LockstepResult:  # fmt: skip
    """Run a flight in lockstep and write its results to options.folder.

    land: returns True if the operator wants to land now. timelapse: store states of the surface, from which recall over
    time is computed. The last argument is the hook of this flight.
    """
    flight = LockstepFlight(options, config, scene, hook, timelapse)
    started_s, processor_s = time.perf_counter(), time.process_time()
    with ProgressDisplay(console, flight.channels) as screen:
        while not hook.over(flight.conductor.finished) and flight.simulated_s < LONGEST_S:
            flight.step(land, screen)
        flight.conductor.close(START_S + flight.simulated_s)
    wall_s, processor_s = time.perf_counter() - started_s, time.process_time() - processor_s
    flight.save(console)
    ended = flight.conductor.finished
    fault = None if ended else f"the flight did not end within {LONGEST_S:.0f} s of simulated time"
    return LockstepResult(fault, flight.simulated_s, wall_s, processor_s)


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
    return {"neural": _neural, "depth-only": _depth_only}[options.mapper](config, options.folder)


def _neural(config: Config, folder: Path) -> Mapper:
    from uav_recon.mapping.keyframe_store import KeyframeFolder
    from uav_recon.mapping.neural.worker.inline_mapper import InlineMapper
    from uav_recon.mapping.neural.worker.mapper_process import KEYFRAMES

    trainer = mapper_factory.make_neural_mapper(config)
    trainer.warm_up()
    return InlineMapper(trainer, config.mapper, KeyframeFolder(folder / KEYFRAMES))


def _depth_only(config: Config, folder: Path) -> Mapper:
    from sitl.apps.depth_only_mapper import DepthOnlyMapper

    return DepthOnlyMapper(config)
