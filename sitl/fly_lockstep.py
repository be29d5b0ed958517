"""The same flight in one process on a manual clock: same objects, same bytes through a pipe in memory, repeatable."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path
from types import FrameType

from rich.console import Console

from sitl.fly_options import SimOptions
from sitl.fly_progress import Screen
from sitl.fly_world import make_world
from sitl.scene import Scene
from sitl.transport import pipe
from uav_recon import run
from uav_recon.autopilot.tlog import Tlog
from uav_recon.clock import InlineExecutor, ManualClock, RateKeeper
from uav_recon.config import Config
from uav_recon.mapping.keyframes import KeyframeFolder
from uav_recon.processes import MISSION_RATE_HZ, RECORDER_RATE_HZ
from uav_recon.recording.flightlog import FlightLog
from uav_recon.recording.mapfile import save_map

STEP_S = 0.01
START_S = 1000.0
LONGEST_S = 3600.0


def fly_in_lockstep(options: SimOptions, config: Config, scene: Scene, console: Console) -> str | None:
    """Fly; returns the fault in one line, None for none. Ctrl-C lands, a second one ends at once."""
    from uav_recon.mapping.neural.child import KEYFRAMES
    from uav_recon.mapping.neural.worker import InlineMapper

    interrupts: list[int] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        interrupts.append(number)
        if len(interrupts) > 1:
            sys.exit(130)

    before = signal.signal(signal.SIGINT, interrupt)
    runtime = config.runtime.folder
    clock = ManualClock(START_S)
    ours, theirs = pipe()
    world = make_world(options.world(Path(runtime)), scene, theirs, clock.now_s)
    wires = run.memory_wires()
    run.warm_up(config)
    trainer = run.make_trainer(config)
    trainer.warm_up()
    mapper = InlineMapper(trainer, config.mapper, KeyframeFolder(options.out / KEYFRAMES))
    log, journal = Tlog(options.out / "flight.tlog", epoch_s=0.0), FlightLog(options.out)
    pilot = run.make_pilot(config, wires, ours, log, clock)
    perception = run.make_perception(config, wires, clock)
    conductor = run.make_conductor(config, wires, mapper, InlineExecutor(clock), journal, clock, time.perf_counter)
    recorder = run.make_recorder(config, wires, options.out, clock)
    conductor.request_start()
    mission_rate, record_rate = RateKeeper(MISSION_RATE_HZ, START_S), RateKeeper(RECORDER_RATE_HZ, START_S)
    steps = 0
    with Screen(console, wires) as screen:
        while not conductor.finished and steps * STEP_S < LONGEST_S:
            steps += 1
            now_s = START_S + steps * STEP_S
            clock.advance_to(now_s)
            world.step(now_s)
            if world.frame_due(now_s):
                world.develop(world.expose(now_s))
            perception.step()
            if mission_rate.due(now_s):
                if interrupts:
                    conductor.request_abort("the operator asked to land")
                conductor.step()
            pilot.step()
            if record_rate.due(now_s):
                recorder.step()
                screen.show()
        conductor.close()
    if conductor.map is not None:
        save_map(options.out, conductor.map)
    mapper.finish(options.out)
    journal.close()
    log.close()
    recorder.close()
    world.truth_log.save(options.out / "truth.npz", world)
    signal.signal(signal.SIGINT, before)
    return None if conductor.finished else f"the flight did not end within {LONGEST_S:.0f} s of simulated time"
