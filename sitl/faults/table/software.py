"""Table A: software death and starvation."""

from __future__ import annotations

import os
from signal import SIGKILL, SIGSTOP

from sitl.faults import reason_codes as codes
from sitl.faults.fault import Onset
from sitl.faults.injectors.companion import Crash, Stall
from sitl.faults.injectors.cpu_and_disk_load import BUSY, DISK_LOAD, BusyProcesses, ProcessUsageMonitor
from sitl.faults.injectors.mavlink_link import COMPANION, GCS, INVALID, ONBOARD_CONTROLLER, ProgramHeartbeats
from sitl.faults.injectors.process_signals import (
    MAPPER,
    ChildProcessSignalled,
    ProcessKilled,
    ProcessStopped,
    ProcessTerminated,
    SecondPilot,
)
from sitl.faults.judges import reaction_metrics as m
from sitl.faults.table.acceptance_limits import (
    NO_FAILSAFE,
    NO_JUMP,
    NO_ORDER,
    STEADY,
    STREAMS,
    UNHEARD_LANDS,
    UNHEARD_STANDS,
    clear,
    down,
    flies_on,
    holds,
    lands,
    lands_no_sooner,
    reports,
    stops,
)
from sitl.faults.table.scenario import Limit, Scenario

FAST = Onset(speed_mps=0.6)
PROGRAMS = ((245, 190, GCS, INVALID), (COMPANION[0], 190, ONBOARD_CONTROLLER, INVALID), (*COMPANION, GCS, INVALID))
TABLE_A = (
    Scenario(
        "A1",
        "planner stalls 5 s",
        "the mission stalls for 5 s during fast flight",
        lambda n: [Stall("mission", for_s=5.0)],
        (
            holds(0.6),
            stops(0.6),
            STEADY,
            STREAMS,
            NO_FAILSAFE,
            NO_JUMP,
            flies_on(1.0, late_s=5.0),
            reports(codes.MISSION_SILENT, codes.MISSION_STALE, within_s=1.6),
        ),
        onset=FAST,
        live=lambda n: [ProcessStopped("mission", 5.0)],
        observe_s=12.0,
        times=3,
    ),
    Scenario(
        "A2",
        "planner stalls 30 s",
        "the mission stalls for 30 s during fast flight, then continues",
        lambda n: [Stall("mission", for_s=30.0)],
        (
            Limit("retreat begun", m.retreat_after, 5.5, "s"),
            Limit("retreat not before", m.retreat_after, 4.5, "s", at_least=True),
            lands(21.0),
            lands_no_sooner(19.0),
            down(45.0),
            STREAMS,
        ),
        onset=FAST,
        live=lambda n: [ProcessStopped("mission", 30.0)],
    ),
    Scenario(
        "A2h",
        "planner hangs",
        "a call to the planner does not return; the mission's own loop continues",
        lambda n: [Stall("planner")],
        (lands(40.0), lands_no_sooner(20.0), down(60.0), STREAMS, NO_FAILSAFE, NO_JUMP),
        onset=FAST,
        observe_s=70.0,
    ),
    Scenario(
        "A3",
        "mission crashes",
        "the mission ends during fast flight; its supervisor restarts it after 5 s",
        lambda n: [Crash("mission", back_s=5.0)],
        (holds(0.6), STREAMS, NO_FAILSAFE, down(120.0)),
        onset=FAST,
        observe_s=125.0,
        live=lambda n: [ProcessKilled("mission", for_s=5.0)],
    ),
    Scenario(
        "A4",
        "out of memory",
        "SIGKILL to the mapper, as by the kernel's out-of-memory killer",
        limits=(
            Limit("mapper replaced after", m.noted("replaced"), 5.0, "s"),
            Limit("pilot's memory", m.noted("memory"), 150.0, "MB"),
            STREAMS,
            NO_FAILSAFE,
            NO_JUMP,
        ),
        observe_s=30.0,
        why="in lockstep the depth-only mapper runs inside the mission: flown in real time",
        live=lambda n: [ChildProcessSignalled(MAPPER, SIGKILL), ProcessUsageMonitor("pilot")],
    ),
    Scenario(
        "A5",
        "mapper hangs",
        "SIGSTOP to the mapper, permanently",
        limits=(Limit("mapper replaced after", m.noted("replaced"), 5.0, "s"), STREAMS, NO_FAILSAFE, NO_JUMP),
        observe_s=30.0,
        why="in lockstep the depth-only mapper runs inside the mission: flown in real time",
        live=lambda n: [ChildProcessSignalled(MAPPER, SIGSTOP)],
    ),
    Scenario(
        "A6",
        "pilot and mission killed",
        "SIGKILL to both at once, without a restart",
        lambda n: [Stall("mission", "pilot", "perception")],
        (UNHEARD_LANDS, UNHEARD_STANDS, Limit("drift", m.drift_landing, 1.5, "m"), down(30.0)),
        onset=FAST,
        live=lambda n: [ProcessKilled("mission", "pilot", "perception")],
    ),
    Scenario(
        "A6r",
        "pilot and mission killed",
        "as A6, in two rooms of 5.8 m by 2.8 m, where the autopilot's own motion must not reach a wall",
        lambda n: [Stall("mission", "pilot", "perception")],
        (clear(0.10), UNHEARD_LANDS, down(30.0)),
        arena="corridor",
        onset=FAST,
    ),
    Scenario(
        "A6m",
        "pilot and mission killed beside other programs",
        "as A6, while heartbeats of a MAVSDK program (245/190) and of another component with the companion's system ID go on",
        lambda n: [Stall("mission", "pilot", "perception"), ProgramHeartbeats(*PROGRAMS, to_autopilot=True)],
        (UNHEARD_LANDS, UNHEARD_STANDS, Limit("drift", m.drift_landing, 1.5, "m"), down(30.0)),
        onset=FAST,
        live=lambda n: [ProcessKilled("mission", "pilot", "perception"), ProgramHeartbeats(*PROGRAMS, to_autopilot=True)],
    ),
    Scenario(
        "A7",
        "pilot restarts in the air",
        "the pilot ends and is restarted after 0.2, 1 and 3 s",
        lambda n: [Crash("pilot", back_s=(0.2, 1.0, 3.0)[n % 3])],
        (NO_ORDER, down(60.0)),
        live=lambda n: [ProcessKilled("pilot", for_s=(0.2, 1.0, 3.0)[n % 3])],
        observe_after_disarm_s=20.0,  # to check that it does not take off again
    ),
    Scenario(
        "A8",
        "second copy started",
        "a second pilot process with the same config",
        limits=(
            Limit("second pilot's exit code minus 75", lambda e: abs(m.noted("second's exit code")(e) - 75.0), 0.0, ""),
            Limit("second pilot ran", m.noted("second lived"), 1.0, "s"),
            STREAMS,
            STEADY,
            NO_FAILSAFE,
        ),
        observe_s=10.0,
        why="needs processes: flown in real time",
        live=lambda n: [SecondPilot()],
    ),
    Scenario(
        "A9",
        "SIGTERM in flight",
        "SIGTERM to the pilot in the air",
        limits=(
            lands(0.5),
            down(30.0),
            Limit("pilot's exit code", m.noted("exit code"), 0.0, ""),
            Limit("ended armed", m.noted("ended armed"), 0.0, ""),
        ),
        why="needs processes: flown in real time",
        live=lambda n: [ProcessTerminated("pilot")],
    ),
    Scenario(
        "A10",
        "overload",
        "four busy processes per core, for 30 s",
        limits=(STREAMS, STEADY, NO_FAILSAFE),
        observe_s=35.0,
        why="needs processes: flown in real time; a separate test lasts ten minutes",
        live=lambda n: [BusyProcesses(BUSY, 4 * (os.cpu_count() or 1), 30.0)],
    ),
    Scenario(
        "A11",
        "stall caused by the disk",
        "16 MB written and synced repeatedly beside the flight's files, for 30 s",
        limits=(Limit("writes by the pilot's loop", m.noted("writes"), 0.0, ""), STREAMS, STEADY, NO_FAILSAFE),
        observe_s=35.0,
        why="needs processes: flown in real time",
        live=lambda n: [BusyProcesses(DISK_LOAD, 2, 30.0), ProcessUsageMonitor("pilot")],
    ),
)
