"""Tables C (camera and depth) and D (link)."""

from __future__ import annotations

from sitl.faults import reason_codes as codes
from sitl.faults.fault import Onset
from sitl.faults.injectors import operator_silence
from sitl.faults.injectors.base import Injector
from sitl.faults.injectors.companion import Crash
from sitl.faults.injectors.crossing_person import CROSSED, PersonCrosses
from sitl.faults.injectors.depth_camera import (
    APPEARED,
    AlteredDepth,
    DepthSilence,
    EmptyAfterLiftOff,
    FrozenImage,
    LateFrames,
    ObstacleAppears,
    ObstacleAppearsLater,
    ObstacleApproaches,
    ReorderedFrames,
    ScatteredFrames,
    ShiftedTimestamps,
    SingleFrames,
    bit_errors,
    constant,
    ghost,
    salted,
    scaled,
    shifted,
    thinned,
)  # fmt: skip
from sitl.faults.injectors.mavlink_link import Corrupted, DuplicatedFrames, Garbage, Jitter, PacketLoss, Unplugged
from sitl.faults.injectors.process_signals import ProcessKilled
from sitl.faults.injectors.vehicle_and_autopilot import Reboot
from sitl.faults.judges import odometry_metrics
from sitl.faults.judges import reaction_metrics as m
from sitl.faults.judges.ghost_voxels import GHOSTS
from sitl.faults.judges.map_integrity import AGAIN, CLAIMED, FREED, Claims, MapIntegrityCheck, Tally
from sitl.faults.table.acceptance_limits import (
    COMPLETES,
    NO_FAILSAFE,
    NO_ORDER,
    RETURN_ACTS,
    RETURNS,
    STEADY,
    STREAMS,
    UNHEARD_LANDS,
    clear,
    down,
    flies_on,
    holds,
    lands,
    reports,
)
from sitl.faults.table.scenario import SHORT_VIEWS, Limit, Scenario

FAST = Onset(speed_mps=0.6)
STILL = Onset(speed_mps=0.0, min_view_depth_m=3.8)
ONCE = Limit("frames mapped again", m.noted(AGAIN), 0.0, "")

PERSON = (
    Limit("the person comes", m.noted(CROSSED), 150.0, "s"),
    Limit("distance from the hull to the person", lambda e: e.min_obstacle_distance_m, 0.50, "m", at_least=True),
    COMPLETES,
    Limit("voxels of the person left", m.noted(GHOSTS), 0.0, ""),
    clear(0.10),
)

TABLE_C = (
    Scenario(
        "C1",
        "frames lost for 0.3 s",
        "no frame for 0.3 s",
        lambda n: [DepthSilence(0.3)],
        (flies_on(2.0, late_s=0.3), STREAMS, NO_FAILSAFE),
        onset=FAST,
        observe_s=12.0,
    ),
    Scenario(
        "C1b",
        "frames lost for 3 s",
        "no frame for 3 s during fast flight",
        lambda n: [DepthSilence(3.0)],
        (holds(0.4), STREAMS, COMPLETES, reports(codes.NO_DEPTH, codes.DEPTH_STALE, within_s=1.4)),
        onset=Onset(speed_mps=0.5),
        observe_s=180.0,
        views=24,
    ),
    Scenario(
        "C1c",
        "frames lost",
        "no more frames",
        lambda n: [DepthSilence()],
        (holds(0.4), Limit("retreat begun", m.retreat_after, 3.5, "s"), lands(10.5)),
        onset=FAST,
    ),
    Scenario(
        "C2",
        "camera unplugged",
        "perception ends during fast flight and is restarted after 2 s",
        lambda n: [Crash("perception", back_s=2.0)],
        (holds(0.3), lands(1.2), down(30.0)),
        onset=FAST,
        live=lambda n: [ProcessKilled("perception", for_s=0.0)],  # its supervisor restarts it
    ),
    Scenario(
        "C3",
        "depth corrupted",
        "random values in 30 % of the pixels; image shifted by 64 pixels; bit errors; half and twice the range; frozen image",
        lambda n: [_corrupt(n), MapIntegrityCheck()],
        (holds(0.5), Limit("known occupied freed", m.noted(FREED), 0.1, "%"), clear(0.10)),
    ),
    Scenario(
        "C4",
        "lens covered",
        "every pixel 0; every pixel 65535",
        lambda n: [AlteredDepth(constant((0, 65535)[n % 2]))],
        (holds(0.4), clear(0.10)),
        onset=FAST,
    ),
    Scenario(
        "C4b",
        "lens covered, map unchanged",
        "as C4, with a check of the map",
        lambda n: [AlteredDepth(constant((0, 65535)[n % 2])), MapIntegrityCheck(), Claims()],
        (Limit("known occupied freed", m.noted(FREED), 0.0, "%"), Limit("voxels marked free", m.noted(CLAIMED), 0.0, "")),
        onset=FAST,
    ),
    Scenario(
        "C4c",
        "single frames wrong",
        "one frame empty every 3 s; every 5 s; with returns in 10 % of the pixels every 3 s; random in 30 % of them; shifted",
        lambda n: [_single(n)],
        (COMPLETES, clear(0.10)),
        observe_s=240.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "C4d",
        "first frames in the air empty",
        "no returns for 1 s after the lift-off",
        lambda n: [EmptyAfterLiftOff(1.0)],
        (COMPLETES, clear(0.10)),
        onset=Onset((0.0, 0.0), at_boot=True),
        observe_s=240.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "C5",
        "glass, black, mirror",
        "surfaces that stereo cannot measure",
        why="the simulator does not render glass",
    ),
    Scenario(
        "C6",
        "frames late",
        "all frames are 0.5 s late",
        lambda n: [LateFrames(0.5)],
        (
            Limit("speed 2 s later", m.speed_from(2.0), 0.3, "m/s"),
            clear(0.10),
        ),
    ),
    Scenario(
        "C7",
        "frames repeated and out of order",
        "each frame twice, every third one after its successor",
        lambda n: [ReorderedFrames(), Tally()],
        (COMPLETES, ONCE),
        observe_s=180.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "C7b",
        "timestamps of another clock for 1 s",
        "one hour early or late, for 1 s during fast flight",
        lambda n: [ShiftedTimestamps((-3600.0, 3600.0)[n % 2], 1.0), Tally()],
        (holds(0.4), STREAMS, flies_on(2.0, late_s=1.0), ONCE),  # before a retreat begins
        onset=FAST,
        observe_s=15.0,
    ),
    Scenario(
        "C7c",
        "timestamps of another clock",
        "one hour early or late, permanently, during fast flight",
        lambda n: [ShiftedTimestamps((-3600.0, 3600.0)[n % 2]), Tally()],
        (holds(0.4), Limit("retreat begun", m.retreat_after, 3.5, "s"), lands(10.5), ONCE),
        onset=FAST,
    ),
    Scenario(
        "C8",
        "obstacle appears",
        "a box appears 1.0 m ahead of the hull during fast flight",
        lambda n: [ObstacleAppears(1.0)],
        (holds(0.25), Limit("distance to the box at rest", m.stopped_short, 0.40, "m", at_least=True), clear(0.10)),
        onset=Onset(speed_mps=0.6, needs_view_ahead=True),
        observe_s=25.0,
    ),
    Scenario(
        "C9",
        "obstacle approaches",
        "while the vehicle holds its position, a box comes from 3 m ahead at 0.8 m/s",
        lambda n: [ObstacleApproaches(0.8)],
        (Limit("clearance to the box", lambda e: e.min_obstacle_distance_m, 0.30, "m", at_least=True), clear(0.10)),
        onset=STILL,
        observe_s=20.0,
    ),
    Scenario(
        "C10",
        "ghost obstacles",
        "a patch 1.1 to 1.5 m away, in the middle of the image or anywhere, in 3 % or 15 % of the frames",
        lambda n: [ScatteredFrames(ghost(centred=n % 2 == 0), (0.03, 0.15)[n // 2 % 2], n)],
        (COMPLETES, clear(0.10)),
        observe_s=240.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "C10b",
        "obstacle appears among ghosts",
        "as C10, and after 10 s or more a box appears 1.0 m ahead of the hull during fast flight",
        lambda n: [ScatteredFrames(ghost(n % 2 == 0), (0.03, 0.15)[n // 2 % 2], n), ObstacleAppearsLater(1.0, 10.0, 0.5)],
        (
            Limit("the box appears", m.noted(APPEARED), 90.0, "s"),
            Limit("clearance to the box", lambda e: e.min_obstacle_distance_m, 0.10, "m", at_least=True),
            clear(0.10),
        ),
        observe_s=120.0,
    ),
    Scenario(
        "C11",
        "person crosses",
        "a person 1.8 m high and 0.5 m wide walks across the view, 0.8 to 2 m ahead, at 0.6 to 1.5 m/s: in flight; in hover",
        lambda n: [PersonCrosses(hovering=n % 2 == 1)],
        PERSON,
        observe_s=300.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "C11b",
        "person crosses, own poses",
        "as C11, with poses of the embedded SLAM",
        lambda n: [PersonCrosses(hovering=n % 2 == 1)],
        PERSON,
        observe_s=300.0,
        views=SHORT_VIEWS,
        arena="room",
        poses="slam",
        camera="d435i",
    ),
)


def _single(n: int) -> Injector:
    cases = ((constant(0), 3.0), (constant(0), 5.0), (thinned(0.1), 3.0), (salted(0.3), 3.0), (shifted(32), 3.0))
    change, every_s = cases[n % len(cases)]
    return SingleFrames(change, every_s)


def _corrupt(n: int) -> Injector:
    changes = (salted(0.3), shifted(32), bit_errors(), scaled(0.5), scaled(2.0))
    return FrozenImage() if n % 6 == 5 else AlteredDepth(changes[n % 6])


TABLE_D = (
    Scenario(
        "D1",
        "nothing received for 1 s",
        "all messages from the autopilot are lost for 1 s during fast flight",
        lambda n: [PacketLoss("down", 1.0)],
        (holds(0.6), NO_FAILSAFE, STREAMS),
        onset=FAST,
        observe_s=12.0,
    ),
    Scenario(
        "D1b",
        "nothing received for 10 s",
        "all messages from the autopilot are lost for 10 s during fast flight",
        lambda n: [PacketLoss("down", 10.0)],
        (holds(0.6), Limit("stream ends", m.streams_after, 3.1, "s"), lands(4.5, ardupilot=3.8), NO_ORDER),
        onset=FAST,
    ),
    Scenario(
        "D2",
        "nothing sent for 3 s",
        "all messages to the autopilot are lost for 3 s",
        lambda n: [PacketLoss("up", 3.0)],
        (UNHEARD_LANDS, NO_ORDER, down(30.0), reports(codes.AUTOPILOT_LANDS, within_s=2.3, ardupilot=3.5)),
        onset=FAST,
    ),
    Scenario(
        "D3",
        "bad link",
        "20 % loss in both directions; delays up to 0.3 s for a minute; a gap of 0.3 s",
        lambda n: [(PacketLoss("both", share=0.2, seed=n), Jitter(0.3, 60.0, n), PacketLoss("both", 0.3))[n % 3]],
        (
            NO_FAILSAFE,
            STEADY,
            Limit("setpoints received per second, over 10 s", m.slowest_ten_seconds_arrived, 20.0, "1/s", at_least=True),
            Limit("gap between setpoints received", m.longest_gap_arrived, 0.5, "s"),  # the autopilot's failsafe time
            COMPLETES,
        ),
        onset=Onset(speed_mps=0.0),
        observe_s=240.0,
        views=22,
    ),
    Scenario(
        "D4",
        "frames repeated and out of order",
        "each frame three times, up to 0.5 s late",
        lambda n: [DuplicatedFrames(0.5)],
        (Limit("arm commands", m.arm_tries, 1.0, ""), NO_FAILSAFE, RETURNS),
        onset=Onset((0.0, 0.0), at_boot=True),
        observe_s=240.0,
        views=14,
    ),
    Scenario(
        "D5",
        "garbage",
        "1 MB/s of random bytes for 10 s; a fifth of the frames corrupted",
        lambda n: [Garbage(1_000_000, 10.0), Corrupted(0.2, n)],
        (NO_FAILSAFE, STEADY, STREAMS, COMPLETES),
        observe_s=180.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "D6",
        "serial line unplugged",
        "the device disappears for 1 s during fast flight",
        limits=(
            holds(0.3, late_s=1.0),
            Limit("poses again after", odometry_metrics.poses_again_after(1.0), 2.0, "s"),
            down(120.0),
        ),
        onset=FAST,
        observe_s=125.0,
        views=SHORT_VIEWS,
        why="needs a serial line (pseudo terminal): flown in real time",
        live=lambda n: [Unplugged(1.0)],
    ),
    Scenario(
        "D7",
        "autopilot restarts in the air",
        "the autopilot restarts with its clock at zero, and a pilot takes over",
        lambda n: [Reboot()],
        (
            NO_ORDER,
            Limit("stream ends", m.streams_after, 1.2, "s"),
            Limit("last wrong pose timestamp", odometry_metrics.misdated_for, 0.15, "s"),
            Limit("first correct pose timestamp", odometry_metrics.dated_after, 1.0, "s"),
        ),
        observe_s=20.0,
    ),
    Scenario(
        "D8",
        "operator lost",
        "no more status queries in flight; in every second flight with forged heartbeats of a ground station",
        lambda n: [operator_silence.OperatorSilent(), *([operator_silence.GroundStation()] if n % 2 else [])],
        (
            RETURN_ACTS,
            Limit("return not before", operator_silence.return_delay, operator_silence.TIMEOUT_S - 1.0, "s", at_least=True),
            Limit("warning", operator_silence.warns_after, 6.0, "s"),
            Limit("detour on the return", operator_silence.detour_on_return(operator_silence.TIMEOUT_S), 3.0, "m"),
            RETURNS,
            down(120.0),
        ),
        observe_s=120.0,
    ),
    Scenario(
        "D8b",
        "operator queries rarely",
        "one status query in ten seconds",
        lambda n: [operator_silence.OperatorIntermittent(10.0)],
        (COMPLETES, Limit("warnings", operator_silence.warnings, 1.0, ""), NO_FAILSAFE),
        observe_s=180.0,
        views=SHORT_VIEWS,
    ),
)
