"""Tables C (camera and depth) and D (link)."""

from __future__ import annotations

from sitl.faults import reason_codes as codes
from sitl.faults.fault import Onset
from sitl.faults.injectors import operator_silence
from sitl.faults.injectors.base import Injector
from sitl.faults.injectors.companion import Crash
from sitl.faults.injectors.depth_camera import (
    AlteredDepth,
    DepthSilence,
    FrozenImage,
    LateFrames,
    ObstacleAppears,
    ObstacleApproaches,
    ReorderedFrames,
    ShiftedTimestamps,
    bit_errors,
    constant,
    salted,
    scaled,
    shifted,
)  # fmt: skip
from sitl.faults.injectors.mavlink_link import Corrupted, DuplicatedFrames, Garbage, Jitter, PacketLoss, Unplugged
from sitl.faults.injectors.process_signals import ProcessKilled
from sitl.faults.injectors.vehicle_and_autopilot import Reboot
from sitl.faults.judges import odometry_metrics
from sitl.faults.judges import reaction_metrics as m
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
    told,
)
from sitl.faults.table.scenario import SHORT_VIEWS, Limit, Scenario

FAST = Onset(speed_mps=0.6)
STILL = Onset(speed_mps=0.0, min_view_depth_m=3.8)
ONCE = Limit("frames mapped again", m.noted(AGAIN), 0.0, "")

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
        "no frame for 3 s at speed",
        lambda n: [DepthSilence(3.0)],
        (holds(0.4), STREAMS, COMPLETES, told(codes.NO_DEPTH, codes.DEPTH_STALE, within_s=1.4)),
        onset=Onset(speed_mps=0.5),
        observe_s=180.0,
        views=24,
    ),
    Scenario(
        "C1c",
        "frames lost",
        "no frame any more",
        lambda n: [DepthSilence()],
        (holds(0.4), Limit("retreat begun", m.retreat_after, 3.5, "s"), lands(10.5)),
        onset=FAST,
    ),
    Scenario(
        "C2",
        "camera unplugged",
        "perception dies at speed and is back after 2 s",
        lambda n: [Crash("perception", back_s=2.0)],
        (holds(0.3), lands(1.2), down(30.0)),
        onset=FAST,
        live=lambda n: [ProcessKilled("perception", for_s=0.0)],  # its supervisor restarts it
    ),
    Scenario(
        "C3",
        "depth corrupted",
        "salt on 30 % of the pixels; 64 pixels aside; bit errors; half and twice the range; frozen",
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
        "lens covered, the map",
        "as C4, and the map is looked at",
        lambda n: [AlteredDepth(constant((0, 65535)[n % 2])), MapIntegrityCheck(), Claims()],
        (Limit("known occupied freed", m.noted(FREED), 0.0, "%"), Limit("voxels marked free", m.noted(CLAIMED), 0.0, "")),
        onset=FAST,
    ),
    Scenario("C5", "glass, black, mirror", "surfaces that stereo does not see", why="T2 and T4: glass is not rendered"),
    Scenario(
        "C6",
        "frames late",
        "all of them 0.5 s late",
        lambda n: [LateFrames(0.5)],
        (
            Limit("speed 2 s later", m.speed_from(2.0), 0.3, "m/s"),
            clear(0.10),
        ),
    ),
    Scenario(
        "C7",
        "frames repeated and out of order",
        "each twice, every third behind the next",
        lambda n: [ReorderedFrames(), Tally()],
        (COMPLETES, ONCE),
        observe_s=180.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "C7b",
        "stamps of another clock for 1 s",
        "an hour ago or ahead, for 1 s at speed",
        lambda n: [ShiftedTimestamps((-3600.0, 3600.0)[n % 2], 1.0), Tally()],
        (holds(0.4), STREAMS, flies_on(2.0, late_s=1.0), ONCE),  # before a retreat begins
        onset=FAST,
        observe_s=15.0,
    ),
    Scenario(
        "C7c",
        "stamps of another clock",
        "an hour ago or ahead, at speed and for good",
        lambda n: [ShiftedTimestamps((-3600.0, 3600.0)[n % 2]), Tally()],
        (holds(0.4), Limit("retreat begun", m.retreat_after, 3.5, "s"), lands(10.5), ONCE),
        onset=FAST,
    ),
    Scenario(
        "C8",
        "obstacle appears",
        "a box stands 1.0 m ahead of the hull, at speed",
        lambda n: [ObstacleAppears(1.0)],
        (holds(0.25), Limit("stops short of it by", m.stopped_short, 0.40, "m", at_least=True), clear(0.10)),
        onset=Onset(speed_mps=0.6, needs_view_ahead=True),
        observe_s=25.0,
    ),
    Scenario(
        "C9",
        "obstacle approaches",
        "told to stay, and a box comes from 3 m ahead at 0.8 m/s to where it hovers",
        lambda n: [ObstacleApproaches(0.8)],
        (Limit("clearance of it", lambda e: e.min_obstacle_distance_m, 0.30, "m", at_least=True), clear(0.10)),
        onset=STILL,
        observe_s=20.0,
    ),
)


def _corrupt(n: int) -> Injector:
    changes = (salted(0.3), shifted(32), bit_errors(), scaled(0.5), scaled(2.0))
    return FrozenImage() if n % 6 == 5 else AlteredDepth(changes[n % 6])


TABLE_D = (
    Scenario(
        "D1",
        "nothing heard for 1 s",
        "autopilot to product lost for 1 s at speed",
        lambda n: [PacketLoss("down", 1.0)],
        (holds(0.6), NO_FAILSAFE, STREAMS),
        onset=FAST,
        observe_s=12.0,
    ),
    Scenario(
        "D1b",
        "nothing heard for 10 s",
        "autopilot to product lost for 10 s at speed",
        lambda n: [PacketLoss("down", 10.0)],
        (holds(0.6), Limit("stream ends", m.streams_after, 3.1, "s"), lands(4.5, ardupilot=3.8), NO_ORDER),
        onset=FAST,
    ),
    Scenario(
        "D2",
        "nothing said for 3 s",
        "product to autopilot lost for 3 s",
        lambda n: [PacketLoss("up", 3.0)],
        (UNHEARD_LANDS, NO_ORDER, down(30.0), told(codes.AUTOPILOT_LANDS, within_s=2.3, ardupilot=3.5)),
        onset=FAST,
    ),
    Scenario(
        "D3",
        "bad link",
        "20 % lost both ways; for a minute up to 0.3 s late; 0.3 s holes",
        lambda n: [(PacketLoss("both", share=0.2, seed=n), Jitter(0.3, 60.0, n), PacketLoss("both", 0.3))[n % 3]],
        (
            NO_FAILSAFE,
            STEADY,
            Limit("setpoints that arrive in a second, of ten", m.slowest_ten_seconds_arrived, 20.0, "1/s", at_least=True),
            Limit("gap between those that arrive", m.longest_gap_arrived, 0.5, "s"),  # the autopilot's failsafe time
            COMPLETES,
        ),
        onset=Onset(speed_mps=0.0),
        observe_s=240.0,
        views=22,
    ),
    Scenario(
        "D4",
        "frames repeated and out of order",
        "each three times, up to 0.5 s late",
        lambda n: [DuplicatedFrames(0.5)],
        (Limit("arm commands", m.arm_tries, 1.0, ""), NO_FAILSAFE, RETURNS),
        onset=Onset((0.0, 0.0), at_boot=True),
        observe_s=240.0,
        views=14,
    ),
    Scenario(
        "D5",
        "garbage",
        "1 MB/s of random bytes for 10 s, then a fifth of the frames spoilt",
        lambda n: [Garbage(1_000_000, 10.0), Corrupted(0.2, n)],
        (NO_FAILSAFE, STEADY, STREAMS, COMPLETES),
        observe_s=180.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "D6",
        "serial line unplugged",
        "the device is gone for 1 s at speed",
        bars=(
            holds(0.3, late_s=1.0),
            Limit("poses again after", odometry_metrics.poses_again_after(1.0), 2.0, "s"),
            down(120.0),
        ),
        onset=FAST,
        observe_s=125.0,
        views=SHORT_VIEWS,
        why="needs a serial line, a pseudo terminal: flown in real time",
        live=lambda n: [Unplugged(1.0)],
    ),
    Scenario(
        "D7",
        "autopilot restarts in the air",
        "it begins anew, clock and all, and a pilot catches it",
        lambda n: [Reboot()],
        (
            NO_ORDER,
            Limit("stream ends", m.streams_after, 1.2, "s"),
            Limit("poses dated wrongly", odometry_metrics.misdated_for, 0.15, "s"),
            Limit("poses dated rightly", odometry_metrics.dated_after, 1.0, "s"),
        ),
        observe_s=20.0,
    ),
    Scenario(
        "D8",
        "operator lost",
        "nobody asks how it stands any more, in flight; every second time somebody forges a ground station's heartbeats",
        lambda n: [operator_silence.OperatorSilent(), *([operator_silence.GroundStation()] if n % 2 else [])],
        (
            RETURN_ACTS,
            Limit("returns not before", operator_silence.return_delay, operator_silence.TIMEOUT_S - 1.0, "s", at_least=True),
            Limit("warned", operator_silence.warns_after, 6.0, "s"),
            Limit("way astray", operator_silence.detour_on_return(operator_silence.TIMEOUT_S), 3.0, "m"),
            RETURNS,
            down(120.0),
        ),
        observe_s=120.0,
    ),
    Scenario(
        "D8b",
        "operator heard now and then",
        "asks how it stands once in ten seconds",
        lambda n: [operator_silence.OperatorIntermittent(10.0)],
        (COMPLETES, Limit("warnings", operator_silence.warnings, 1.0, ""), NO_FAILSAFE),
        observe_s=180.0,
        views=SHORT_VIEWS,
    ),
)
