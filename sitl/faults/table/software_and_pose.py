"""Tables A (software death and starvation) and B (pose and SLAM)."""

from __future__ import annotations

import os
from signal import SIGKILL, SIGSTOP

from sitl.faults import reason_codes as codes
from sitl.faults.fault import Onset
from sitl.faults.injectors.companion import Crash, Stall
from sitl.faults.injectors.cpu_and_disk_load import BUSY, DISK_LOAD, BusyProcesses, ProcessUsageMonitor
from sitl.faults.injectors.pose_stream import (
    AlteredPoses,
    FrozenPose,
    LatePoses,
    PoseSilence,
    ThinnedPoses,
    drifting,
    invalid,
    map_turned,
    moved,
    stamped,
    turned,
)  # fmt: skip
from sitl.faults.injectors.process_signals import (
    MAPPER,
    ChildProcessSignalled,
    ProcessKilled,
    ProcessStopped,
    ProcessTerminated,
    SecondPilot,
)
from sitl.faults.judges import odometry_metrics
from sitl.faults.judges import reaction_metrics as m
from sitl.faults.judges.statustext_checks import statustext_delay
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
    stops,
    told,
)
from sitl.faults.table.scenario import Limit, Scenario

FAST = Onset(speed_mps=0.6)
ON_STAGE = Onset(speed_mps=0.6, away_m=4.2)
GONE_AND_BACK = tuple(((0.5, 2.0, 10.0)[n % 3], (0.0, 0.3, 1.0)[(n + n // 3) % 3]) for n in range(9))
CLOSURES = (moved(x=0.5), moved(y=2.0), map_turned(10.0))
SPOILT = tuple(
    invalid(k) for k in ("nan place", "inf place", "nan turn", "zero turn", "long turn", "nan variance", "nan stamp")
)
# Inertial samples continue the pose over the 0.33 s that B10 needs; pose_lost_s ends that. A constant pose must not be sent.
NEVER_REPEATS = (
    Limit("ODOMETRY ends", odometry_metrics.poses_until, 0.5, "s"),
    Limit("motion of the error", odometry_metrics.pose_error_step(), 0.05, "m"),
)

TABLE_A = (
    Scenario(
        "A1",
        "planner stalls 5 s",
        "mission stands still for 5 s at speed",
        lambda n: [Stall("mission", for_s=5.0)],
        (
            holds(0.6),
            stops(0.6),
            STEADY,
            STREAMS,
            NO_FAILSAFE,
            NO_JUMP,
            flies_on(1.0, late_s=5.0),
            told(codes.MISSION_SILENT, codes.MISSION_STALE, within_s=1.6),
        ),
        onset=FAST,
        live=lambda n: [ProcessStopped("mission", 5.0)],
        observe_s=12.0,
        times=3,
    ),
    Scenario(
        "A2",
        "planner stalls 30 s",
        "mission stands still for 30 s at speed, then goes on",
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
        "a call to the planner does not return; the mission's own loop goes on",
        lambda n: [Stall("planner")],
        (lands(40.0), lands_no_sooner(20.0), down(60.0), STREAMS, NO_FAILSAFE, NO_JUMP),
        onset=FAST,
        observe_s=70.0,
    ),
    Scenario(
        "A3",
        "mission crashes",
        "mission dies at speed; its supervisor has a new one running after 5 s",
        lambda n: [Crash("mission", back_s=5.0)],
        (holds(0.6), STREAMS, NO_FAILSAFE, down(120.0)),
        onset=FAST,
        observe_s=125.0,
        live=lambda n: [ProcessKilled("mission", for_s=5.0)],
    ),
    Scenario(
        "A4",
        "out of memory",
        "the mapper is killed, as the kernel does it at its limit",
        bars=(
            Limit("another mapper after", m.noted("replaced"), 5.0, "s"),
            Limit("pilot's memory", m.noted("memory"), 150.0, "MB"),
            STREAMS,
            NO_FAILSAFE,
            NO_JUMP,
        ),
        observe_s=30.0,
        why="the mapper is a stand-in inside the mission in lockstep: flown in real time",
        live=lambda n: [ChildProcessSignalled(MAPPER, SIGKILL), ProcessUsageMonitor("pilot")],
    ),
    Scenario(
        "A5",
        "mapper hangs",
        "SIGSTOP to the mapper, for ever",
        bars=(Limit("another mapper after", m.noted("replaced"), 5.0, "s"), STREAMS, NO_FAILSAFE, NO_JUMP),
        observe_s=30.0,
        why="the mapper is a stand-in inside the mission in lockstep: flown in real time",
        live=lambda n: [ChildProcessSignalled(MAPPER, SIGSTOP)],
    ),
    Scenario(
        "A6",
        "pilot and mission killed",
        "SIGKILL to both at once, for ever",
        lambda n: [Stall("mission", "pilot", "perception")],
        (UNHEARD_LANDS, UNHEARD_STANDS, Limit("drift", m.drift_landing, 1.5, "m"), down(30.0)),
        onset=FAST,
        live=lambda n: [ProcessKilled("mission", "pilot", "perception")],
    ),
    Scenario(
        "A6r",
        "pilot and mission killed",
        "as A6, in two rooms of 5.8 m by 2.8 m: what the autopilot flies on by itself stays clear of their walls",
        lambda n: [Stall("mission", "pilot", "perception")],
        (clear(0.10), UNHEARD_LANDS, down(30.0)),
        arena="corridor",
        onset=FAST,
    ),
    Scenario(
        "A7",
        "pilot restarts in the air",
        "pilot dies and is back after 0.2, 1 and 3 s",
        lambda n: [Crash("pilot", back_s=(0.2, 1.0, 3.0)[n % 3])],
        (NO_ORDER, down(60.0)),
        live=lambda n: [ProcessKilled("pilot", for_s=(0.2, 1.0, 3.0)[n % 3])],
        observe_after_disarm_s=20.0,  # to check that it does not take off again
    ),
    Scenario(
        "A8",
        "second copy started",
        "another pilot, by hand, with the same config",
        bars=(
            Limit("its exit code, off 75", lambda e: abs(m.noted("second's exit code")(e) - 75.0), 0.0, ""),
            Limit("it lived", m.noted("second lived"), 1.0, "s"),
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
        "SIGTERM to the pilot at height",
        bars=(
            lands(0.5),
            down(30.0),
            Limit("its exit code", m.noted("exit code"), 0.0, ""),
            Limit("ended armed", m.noted("ended armed"), 0.0, ""),
        ),
        why="needs processes: flown in real time",
        live=lambda n: [ProcessTerminated("pilot")],
    ),
    Scenario(
        "A10",
        "overload",
        "four busy programs for each core, for 30 s",
        bars=(STREAMS, STEADY, NO_FAILSAFE),
        observe_s=35.0,
        why="needs processes: flown in real time; ten minutes of it are a test of their own",
        live=lambda n: [BusyProcesses(BUSY, 4 * (os.cpu_count() or 1), 30.0)],
    ),
    Scenario(
        "A11",
        "stall by the disk",
        "16 MB written and synced again and again beside the flight's files, for 30 s",
        bars=(Limit("writes by the pilot's loop", m.noted("writes"), 0.0, ""), STREAMS, STEADY, NO_FAILSAFE),
        observe_s=35.0,
        why="needs processes: flown in real time",
        live=lambda n: [BusyProcesses(DISK_LOAD, 2, 30.0), ProcessUsageMonitor("pilot")],
    ),
)

TABLE_B = (
    Scenario(
        "B1",
        "pose stops",
        "no pose any more, at speed",
        lambda n: [PoseSilence()],
        (
            holds(0.3),
            lands(1.2),
            Limit("drift", m.drift_landing, 0.8, "m"),
            down(30.0),
            told(codes.NO_POSE, codes.POSE_STALE, within_s=1.3),
            *NEVER_REPEATS,
        ),
        onset=FAST,
        times=3,
    ),
    Scenario(
        "B1s",
        "pose stops over furniture",
        "no pose any more, at speed and over a stage 0.6 m high: it lands on what is below it",
        lambda n: [PoseSilence()],
        (
            holds(0.3),
            lands(1.2),
            down(30.0),
            Limit("rests over the floor", m.rests_at, 0.55, "m", at_least=True),
        ),
        onset=ON_STAGE,
        arena="stage",
    ),
    Scenario(
        "B2",
        "pose comes back",
        "no pose for 0.5, 2, 10 s; back with an offset of 0, 0.3, 1 m",
        lambda n: [
            PoseSilence(GONE_AND_BACK[n % 9][0]),
            AlteredPoses(moved(x=GONE_AND_BACK[n % 9][1]), from_s=GONE_AND_BACK[n % 9][0]),
        ],
        (NO_JUMP, Limit("takes back a landing", m.relaunched, 0.0, "")),
    ),
    Scenario(
        "B3",
        "pose spike",
        "one pose off by 0.5 m",
        lambda n: [AlteredPoses(moved(x=0.5), count=1)],
        (Limit("motion of the error", odometry_metrics.pose_error_step(2.0), 0.05, "m"), NO_FAILSAFE),
        observe_s=12.0,
    ),
    Scenario(
        "B4",
        "pose jumps and stays",
        "every pose off by 0.5 m, 2 m, odom turned by 10 degrees",
        lambda n: [AlteredPoses(CLOSURES[n % 3])],
        (
            Limit("step of ODOMETRY", odometry_metrics.pose_step, 0.05, "m"),
            Limit("motion of the error", odometry_metrics.pose_error_step(10.0), 0.10, "m"),
            Limit("reset counter", odometry_metrics.resets, 1.0, ""),
        ),
        observe_s=16.0,
        times=3,
    ),
    Scenario(
        "B5",
        "pose drifts",
        "0.05 m/s for a minute along either axis",
        lambda n: [AlteredPoses(drifting(*((0.05, 0.0), (0.0, 0.05), (-0.05, 0.0), (0.0, -0.05))[n % 4]))],
        (clear(0.10), Limit("alarm", statustext_delay(*codes.DRIFT), 10.0, "s")),
        observe_s=80.0,
        camera="small",
    ),
    Scenario("B6", "height drifts, scale is wrong", "z ramp, scale 0.9 and 1.1", why="waits for perception"),
    Scenario(
        "B7",
        "poses make no sense",
        "NaN, infinite, zero or long in each field",
        lambda n: [AlteredPoses(SPOILT[n % len(SPOILT)])],
        (Limit("NaN on the wire", lambda e: float(e.wire.not_finite), 0.0, ""), holds(0.3), lands(1.2), *NEVER_REPEATS),
        onset=FAST,
    ),
    Scenario(
        "B8",
        "poses are late",
        "poses 0.1 s late",
        lambda n: [LatePoses(0.1)],
        (
            Limit("oldest pose sent", odometry_metrics.pose_age, 0.15, "s"),
            Limit("motion of the error", odometry_metrics.pose_error_step(), 0.05, "m"),
            NO_FAILSAFE,
        ),
        onset=FAST,
        observe_s=15.0,
    ),
    Scenario(
        "B8l",
        "stamps too old, wrong",
        "poses 0.3, 1 s late; a frozen stamp; 5 s in the future",
        lambda n: [(LatePoses(0.3), LatePoses(1.0), FrozenPose(), AlteredPoses(stamped(5.0)))[n % 4]],
        (
            Limit("oldest pose sent", odometry_metrics.pose_age, 0.15, "s"),
            Limit("motion of the error", odometry_metrics.pose_error_step(), 0.10, "m"),  # as B4: kept through the braking
            holds(0.3),
            lands(1.2),
        ),
        onset=FAST,
    ),
    Scenario(
        "B9",
        "heading flips once",
        "one pose turned by 180, 90, 15 degrees",
        lambda n: [AlteredPoses(turned((180.0, 90.0, 15.0)[n % 3]), count=1)],
        (
            Limit("motion of the error", odometry_metrics.pose_error_step(2.0), 0.05, "m"),
            Limit("heading off", odometry_metrics.heading_error_step(2.0), 2.0, "deg"),
            NO_FAILSAFE,
        ),
        observe_s=12.0,
    ),
    Scenario(
        "B9p",
        "heading flips for good",
        "every pose turned by 180, 90, 15 degrees",
        lambda n: [AlteredPoses(turned((180.0, 90.0, 15.0)[n % 3]))],
        (lands(1.5), Limit("off its way", m.off_its_way, 0.3, "m"), Limit("drift", m.drift_landing, 0.8, "m")),
    ),
    Scenario(
        "B10",
        "few poses",
        "6 poses a second",
        lambda n: [ThinnedPoses(6.0)],
        (
            Limit("ODOMETRY in a second", odometry_metrics.pose_rate, 28.0, "1/s", at_least=True),
            Limit("speed 1 s later", m.speed_from(2.0), 0.3, "m/s"),  # after the one second over which the rate is measured
        ),
        observe_s=15.0,
    ),
    Scenario(
        "B10b",
        "too few poses",
        "3 poses a second, at speed",
        lambda n: [ThinnedPoses(3.0)],
        (
            Limit("ODOMETRY in a second", odometry_metrics.pose_rate, 28.0, "1/s", at_least=True),
            holds(2.0),  # the rate is measured over one second
            Limit("speed from 3 s on", m.speed_from(3.0), 0.02, "m/s"),
        ),
        onset=FAST,
        observe_s=15.0,
    ),
    Scenario("B11", "nothing to track", "dark, blank wall, blur", why="needs a tracker on pictures: waits for perception"),
    Scenario("B12", "frames mixed up", "axes swapped in the config", why="waits for perception"),
)
