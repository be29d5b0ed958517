"""Tables E (authority), F (geometry) and G (host)."""

from __future__ import annotations

import math
from signal import SIGSTOP

from sitl.faults import reason_codes as codes
from sitl.faults.fault import Onset
from sitl.faults.injectors.companion import Abort, FileSizeLimit, HostilePlannerMarker
from sitl.faults.injectors.cpu_and_disk_load import FileSizeLimitOfProcesses
from sitl.faults.injectors.depth_camera import StaticObstacle
from sitl.faults.injectors.mavlink_link import (
    COMPANION,
    GCS,
    GENERIC,
    INVALID,
    ONBOARD_CONTROLLER,
    QUADROTOR,
    SYS_STATUS,
    DroppedCommand,
    FalseBatteryCharge,
    PacketLoss,
    ProgramHeartbeats,
    RewrittenFrames,
    SecondAutopilot,
    SpoofedSystem,
    version,
)
from sitl.faults.injectors.process_signals import RECORDER, ChildProcessSignalled
from sitl.faults.injectors.vehicle_and_autopilot import (
    BatteryDrain,
    LandDetectorFailed,
    Parameter,
    Push,
    SidewaysForce,
    Takeover,
    TransmitterLost,
    WeakRotors,
)
from sitl.faults.judges import reaction_metrics as m
from sitl.faults.judges.battery_return import reserve, turned_at
from sitl.faults.judges.invariants import Room
from sitl.faults.judges.manual_takeover import mode_taken_back
from sitl.faults.judges.statustext_checks import statustext_after_arming, statustext_on_floor
from sitl.faults.table.acceptance_limits import (
    COMPLETES,
    NEVER_ARMED,
    NO_FAILSAFE,
    NO_FORCE,
    RETURNS,
    STEADY,
    STREAMS,
    clear,
    down,
    holds,
    lands,
    reports,
)  # fmt: skip
from sitl.faults.table.arenas import GAP, PEN, START
from sitl.faults.table.scenario import SHORT_VIEWS, Limit, Scenario

AT_BOOT = Onset((0.0, 0.0), at_boot=True)
ANY = Onset((0.0, 15.0), speed_mps=0.0)
FAST = Onset(speed_mps=0.6)
PILOT_MODES = (("POSCTL", "POSHOLD"), ("ALTCTL", "ALT_HOLD"), ("STABILIZED", "STABILIZE"), ("LOITER",))
AROUND_LAND_S = (0.0, 0.04, 1.5, 0.02, 0.06, 0.7, 0.08, 0.1)  # delay of the pilot's switch after the operator's land command
PARAMETERS = (  # of each firmware, with values that it allows
    (("COM_OBL_RC_ACT", 0), ("FS_GCS_ENABLE", 0)),
    (("COM_OF_LOSS_T", 5.0), ("FS_GCS_TIMEOUT", 5)),
    (("COM_LOW_BAT_ACT", 0), ("BATT_FS_LOW_ACT", 0)),
    (("NAV_RCL_ACT", 2), ("FS_THR_ENABLE", 0)),
    (("MPC_XY_VEL_MAX", 12.0), ("WP_SPD", 10.0)),
    (("EKF2_EV_CTRL", 0), ("VISO_TYPE", 0)),
    (("GF_ACTION", 2), ("FENCE_ACTION", 0)),
    (("COM_RC_OVERRIDE", 1), ("GUID_TIMEOUT", 3.0)),
)
PROGRAMS = (  # system, component, MAV_TYPE, MAV_AUTOPILOT
    (1, 1, GCS, INVALID),  # mavp2p
    (1, 1, QUADROTOR, GENERIC),
    (1, 1, ONBOARD_CONTROLLER, INVALID),
    (*COMPANION, GCS, INVALID),
)
_ARM = 400
_ORIGIN = 48
_VERSION = 148
PUSH_MPS2 = 5.0 / 2.0  # 5 N on a vehicle of 2 kg

TABLE_E = (
    Scenario(
        "E1",
        "pilot switches the mode",
        "at a random moment, each mode in turn",
        lambda n: [Takeover(*PILOT_MODES[n % 4])],
        (
            Limit("time steps in another mode", m.mode_lost, 0.0, ""),
            Limit("mode or arm commands", m.commands_once_known, 0.0, ""),
            Limit("stream ends", m.streams_after, 0.3, "s"),
        ),
        onset=ANY,
        observe_s=12.0,
        times=3,
    ),
    Scenario(
        "E1b",
        "pilot switches during our mode command",
        "within 0.1 s of the operator's land command, and during that landing",
        lambda n: [Abort(), Takeover(*PILOT_MODES[n % 3], later_s=AROUND_LAND_S[n % len(AROUND_LAND_S)])],
        (
            Limit("time steps in another mode", mode_taken_back, 0.0, ""),
            Limit("mode or arm commands", m.commands_once_known, 0.0, ""),
            Limit("stream ends", m.streams_after, 0.5, "s"),
        ),
        onset=ANY,
        observe_s=15.0,
    ),
    Scenario(
        "E2",
        "pilot moves the sticks",
        "the firmware's reaction: position mode",
        lambda n: [Takeover("POSCTL", "LOITER")],
        (
            Limit("mode or arm commands", m.commands_once_known, 0.0, ""),
            Limit("stream ends", m.streams_after, 0.3, "s"),
            Limit("time steps in another mode", m.mode_lost, 0.0, ""),
        ),
        onset=FAST,
        observe_s=12.0,
    ),
    Scenario(
        "E3",
        "transmitter lost",
        "the RC transmitter is switched off",
        lambda n: [TransmitterLost()],
        (lands(1.6, ardupilot=1.5), Limit("time steps in a stick mode", m.position_mode, 0.0, ""), down(30.0)),
    ),
    Scenario(
        "E4",
        "forged commands",
        "another system, another component, MAVLink 1: modes, disarm, terminate, positions",
        lambda n: [SpoofedSystem(*((42, 1), (1, 77), COMPANION, (1, 1))[n % 4], version_1=n % 4 == 3)],
        (NO_FAILSAFE, COMPLETES, reports(*codes.INTRUDERS, within_s=1.0)),
        observe_s=240.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "E4b",
        "second autopilot",
        "a second autopilot with the vehicle's own ID sends for 10 s: in our mode, armed and disarmed",
        lambda n: [SecondAutopilot(SecondAutopilot.OURS, armed=n % 2 == 0)],
        (holds(1.0), reports(codes.TWO_AUTOPILOTS, within_s=1.0), NO_FAILSAFE, COMPLETES),
        observe_s=240.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "E4c",
        "second autopilot's mode",
        "a second autopilot with the vehicle's own ID reports a pilot's mode for 10 s, and for 0.1 s",
        lambda n: [SecondAutopilot(SecondAutopilot.PILOTS, briefly=n % 2 == 1)],
        (reports(codes.TWO_AUTOPILOTS, codes.MODE_CHANGED, within_s=1.0), lands(5.0), down(30.0)),
        observe_s=45.0,
    ),
    Scenario(
        "E4d",
        "second autopilot lands",
        "a second autopilot with the vehicle's own ID reports a landing mode for 10 s, and for 0.1 s",
        lambda n: [SecondAutopilot(SecondAutopilot.LANDING, briefly=n % 2 == 1)],
        (reports(codes.TWO_AUTOPILOTS, codes.AUTOPILOT_LANDS, within_s=1.0), holds(1.0), down(120.0)),
        observe_s=120.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "E4e",
        "heartbeats of other programs",
        "a router or companion program sends with the autopilot's ID, with states of its own too, or with the product's ID",
        lambda n: [ProgramHeartbeats(PROGRAMS[n % len(PROGRAMS)], states=n % len(PROGRAMS) < 2)],
        (reports(codes.INTRUDER_HEARTBEAT, codes.INTRUDER_OWN_ID, within_s=1.0), STREAMS, NO_FAILSAFE, COMPLETES),
        observe_s=180.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "E4f",
        "heartbeats of other programs from boot",
        "as E4e, from boot",
        lambda n: [ProgramHeartbeats(PROGRAMS[n % len(PROGRAMS)], states=n % len(PROGRAMS) < 2)],
        (
            Limit("first arm command", m.first_arm, 60.0, "s"),
            reports(codes.INTRUDER_HEARTBEAT, codes.INTRUDER_OWN_ID, within_s=60.0),  # once the flight begins
            NO_FAILSAFE,
            RETURNS,
        ),
        onset=AT_BOOT,
        observe_s=240.0,
        views=14,
    ),
    Scenario(
        "E5",
        "battery low",
        "falls to 30 %, then by 0.5 % per second; drops to 78 % at once; drops to 24 % at once",
        lambda n: [(BatteryDrain(0.30, 0.005), BatteryDrain(0.78), BatteryDrain(0.24))[n % 3]],
        (
            Limit("charge left", m.battery_left, 0.10, "", at_least=True),
            Limit("distance from the pad", m.from_pad, 0.5, "m"),
            NO_FAILSAFE,
            down(160.0),  # duration of a flight that a single jump correctly does not end
        ),
        observe_s=160.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "E5b",
        "battery gauge fails briefly",
        "for 2 s, six times, it reports 20 %; 0 %; 24 %",
        lambda n: [FalseBatteryCharge(*((5.0 * k, 5.0 * k + 2.0, (0.20, 0.0, 0.24)[n % 3]) for k in range(6)))],
        (Limit("flights ended for the battery", m.ended_for(*codes.BATTERY), 0.0, ""), COMPLETES, NO_FAILSAFE),
        observe_s=180.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "E5c",
        "battery gauge fails",
        "it reports an unknown charge; it reports nothing; it reports 60 %, then 100 %",
        lambda n: [
            (
                FalseBatteryCharge((0.0, 1e9, math.nan)),
                PacketLoss("down", only=(SYS_STATUS,)),
                FalseBatteryCharge((0.0, 5.0, 0.6), (5.0, 1e9, 1.0)),
            )[n % 3]
        ],
        (down(60.0), RETURNS),
        observe_s=180.0,
    ),
    Scenario(
        "E5d",
        "small battery, far from home",
        "a battery for seven minutes, charged to 78 % at boot, in a gallery of 32 m",
        lambda n: [BatteryDrain(0.78, 0.0023)],
        (
            Limit("reserve for the return", reserve, 1.3, "", at_least=True),
            Limit("turn-back distance", turned_at, 8.0, "m", at_least=True),
            Limit("charge left", m.battery_left, 0.20, "", at_least=True),
            RETURNS,
        ),
        onset=AT_BOOT,
        arena="gallery",
        observe_s=330.0,
        views=120,
        variant="explore",
    ),
    Scenario(
        "E6",
        "arming refused",
        "arm commands have no effect",
        lambda n: [DroppedCommand(_ARM)],
        (
            NEVER_ARMED,
            NO_FORCE,
            Limit("arm commands", m.arm_tries, 3.0, ""),
            Limit("arming given up after", m.last_try_after, 20.0, "s"),
            Limit("reason reported", statustext_after_arming(codes.ARMING_GIVEN_UP), 20.0, "s"),
        ),
        onset=AT_BOOT,
        observe_s=60.0,
    ),
    Scenario(
        "E7",
        "take-off fails",
        "the rotors are too weak to climb",
        lambda n: [WeakRotors()],
        (Limit("motors ran", m.motors_ran, 6.0, "s"), Limit("arm commands", m.arm_tries, 1.0, "")),
        onset=AT_BOOT,
        observe_s=90.0,
    ),
    Scenario(
        "E8",
        "pad occupied",
        "a box stands on the pad when the vehicle returns",
        lambda n: [StaticObstacle((0.0, 0.0, 0.1), (0.25, 0.25, 0.2))],
        (Limit("landing distance to the box", m.lands_beside, 0.30, "m", at_least=True), clear(0.10), down(180.0), NO_FAILSAFE),
        onset=Onset(speed_mps=0.0, away_m=2.0),
        observe_s=180.0,
        views=22,
    ),
    Scenario(
        "E9",
        "landing not detected",
        "the motors do not stop on the floor",
        lambda n: [LandDetectorFailed(), Abort()],
        (Limit("alert", statustext_on_floor(codes.LANDING_NOT_ENDING), 15.0, "s"), NO_FORCE),
        observe_s=25.0,
    ),
    Scenario(
        "E10",
        "operator commands a landing",
        "one land command",
        lambda n: [Abort()],
        (
            Limit("command to land", m.asked_to_land, 0.15, "s"),
            lands(0.5),
            down(30.0),
            reports(codes.OPERATOR_LAND, codes.MISSION_LAND, within_s=1.15),
        ),
        onset=ANY,
    ),
)

TABLE_F = (
    Scenario(
        "F1",
        "hostile planner",
        "harmful trajectories at 30 Hz: NaN, far, fast, outside the fence, other map epochs, other times",
        limits=(STREAMS, NO_FAILSAFE, clear(0.10), lands(25.0), down(40.0)),
        observe_s=45.0,
        injectors=lambda n: [HostilePlannerMarker()],
        times=3,
    ),
    Scenario(
        "F2",
        "pushed out of the fence",
        "5 N on 2 kg for 2 s along the direction of travel, in a pen inside the hall",
        lambda n: [Push(PUSH_MPS2, 2.0)],
        (
            Limit("fence overshoot", m.overshoot, 0.30, "m"),
            Limit("time outside the inset fence", m.back_inside, 3.0, "s"),
            STREAMS,
        ),
        arena="pen",
        onset=FAST,
        observe_s=15.0,
    ),
    Scenario(
        "F2b",
        "pushed out of the fence and held there",
        "the force that holds it 0.2 m outside the fence until it has landed, in a pen inside the hall",
        lambda n: [SidewaysForce(PEN[4] - START[1] + 0.25)],
        (
            Limit("landing mode after leaving", m.landing_after_leaving, 3.5, "s"),
            # after a long refusal the mission may request the landing before the fence check does
            Limit("landing mode not before", m.landing_after_leaving, 0.0, "s", at_least=True, ardupilot=2.8),
            STREAMS,
            down(30.0),
        ),
        arena="pen",
        onset=FAST,
    ),
    Scenario("F3", "invalid fence", "invalid corners", why="no flight: covered by tests of the config"),
    Scenario(
        "F4",
        "no origin",
        "SET_GPS_GLOBAL_ORIGIN never arrives",
        lambda n: [PacketLoss("up", only=(_ORIGIN,))],
        (NEVER_ARMED,),
        onset=AT_BOOT,
        observe_s=20.0,
    ),
    Scenario(
        "F5",
        "path home blocked",
        "a wall blocks the hall behind the vehicle, and the battery is low",
        lambda n: [StaticObstacle((2.0, 0.0, 1.4), (0.1, 3.5, 1.5)), BatteryDrain(0.24)],
        (clear(0.05), Limit("landing mode after the last stop", m.landing_after_a_stop, 5.0, "s"), down(90.0)),
        onset=Onset((8.0, 12.0), needs_view_ahead=True, away_m=4.5),
        observe_s=100.0,
        room=Room(clear_m=0.05),  # no contact; where images are rejected at first, it comes back to within 0.09 m
    ),
    Scenario(
        "F6",
        "narrow passage",
        "no fault: a gap of 0.9 m between two rooms, for hull diameters of 0.5 m and 0.4 m in turn",
        lambda n: [],
        (
            Limit("clearance in the gap", GAP.clearance, 0.15, "m", at_least=True),
            clear(0.10),
            Limit("neither passed nor refused", GAP.untried, 0.0, ""),
            RETURNS,
        ),
        arena="corridor",
        onset=AT_BOOT,
        observe_s=300.0,
        views=46,
        radii_m=(0.25, 0.20),
        variant="explore",  # a variant that does not use up its views on the first room's surface
    ),
)

TABLE_G = (
    Scenario(
        "G1",
        "wall clock jumps",
        "one hour forward and back",
        why="the wall clock is not read in flight; tests fly a signed link with a changed wall clock",
    ),
    Scenario(
        "G2",
        "disk full",
        "no file can grow from the climb on",
        lambda n: [FileSizeLimit()],
        (NO_FAILSAFE, STREAMS, COMPLETES),
        observe_s=180.0,
        views=SHORT_VIEWS,
        live=lambda n: [FileSizeLimitOfProcesses()],
    ),
    Scenario(
        "G3",
        "viewer slow or dead",
        "SIGSTOP to the recorder, the only process connected to a viewer",
        limits=(NO_FAILSAFE, STREAMS, STEADY, COMPLETES),
        observe_s=180.0,
        views=SHORT_VIEWS,
        why="the recorder is a separate process: flown in real time",
        live=lambda n: [ChildProcessSignalled(RECORDER, SIGSTOP)],
    ),
    Scenario(
        "G4", "bad config", "changed, missing, unknown and duplicate keys", why="no flight: covered by tests of the config"
    ),
    Scenario(
        "G5",
        "wrong parameters",
        "one of the firmware's parameters differs from the required value",
        lambda n: [Parameter(*PARAMETERS[n % len(PARAMETERS)])],
        (NEVER_ARMED,),
        onset=AT_BOOT,
        observe_s=20.0,
    ),
    Scenario(
        "G5b",
        "parameter changed in flight",
        "as G5, written by a ground station during fast flight",
        lambda n: [Parameter(*PARAMETERS[n % 5])],  # the others would end its poses, or set the action at a fence
        (holds(1.0), reports(codes.PARAMETER_CHANGED, within_s=1.0), down(60.0), NO_FAILSAFE),
        onset=Onset(speed_mps=0.5),
    ),
    Scenario(
        "G6",
        "wrong firmware",
        "AUTOPILOT_VERSION reports 1.13.0, 1.15.1, 1.18.0",
        lambda n: [RewrittenFrames(_VERSION, version(*((1, 13, 0), (1, 15, 1), (1, 18, 0))[n % 3]))],
        (NEVER_ARMED,),
        onset=AT_BOOT,
        observe_s=20.0,
    ),
    Scenario("G7", "power lost", "the power supply is disconnected", why="needs hardware; A6 covers the reaction"),
    Scenario(
        "G8",
        "time to ready",
        "no fault",
        lambda n: [],
        (Limit("first arm command", m.first_arm, 60.0, "s"),),
        onset=AT_BOOT,
        observe_s=25.0,  # an arm command after that counts as none
    ),
    Scenario(
        "G9", "soak", "a flight of two hours", why="run separately: --only G9 --real-time; G9-5min and G9-1min are shorter"
    ),
    Scenario(
        "G10", "combinations", "two of A1 B1 B4 C1 D2 D8 E1 E5 F2 G2 in one flight", why="45 pairs: --only G10 flies them"
    ),
)
