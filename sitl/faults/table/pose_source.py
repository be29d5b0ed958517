"""Table B: pose and SLAM."""

from __future__ import annotations

import math
from collections.abc import Callable

from sitl.faults import reason_codes as codes
from sitl.faults.fault import Onset
from sitl.faults.injectors.base import Injector
from sitl.faults.injectors.inertial_sensor import (
    AlteredImu,
    FrozenImu,
    ImuSilence,
    offset_force,
    scaled_force,
    vibration,
)
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
    other_origin,
    scaled,
    stamped,
    turned,
)  # fmt: skip
from sitl.faults.injectors.vehicle_and_autopilot import HeightDatumMoved, VerticalVelocityError
from sitl.faults.injectors.wrong_axes import (
    LEFT,
    UPSIDE_DOWN,
    CameraTurned,
    body_turned,
    height_negated,
    imu_axes,
    ned,
)
from sitl.faults.judges import odometry_metrics
from sitl.faults.judges import reaction_metrics as m
from sitl.faults.judges.invariants import Room
from sitl.faults.judges.statustext_checks import statustext_after_arm_command
from sitl.faults.table.acceptance_limits import (
    COMPLETES,
    NEVER_ARMED,
    NO_FAILSAFE,
    NO_JUMP,
    STREAMS,
    clear,
    down,
    holds,
    lands,
    reports,
)
from sitl.faults.table.scenario import SHORT_VIEWS, Limit, Scenario

FAST = Onset(speed_mps=0.6)
AT_ONCE = Onset((0.0, 0.5), speed_mps=0.0)
OFFSETS = tuple((mps2, 0.0) if k else (0.0, mps2) for mps2 in (1.0, 2.0, 4.0, 8.0) for k in (0, 1))
ON_STAGE = Onset(speed_mps=0.6, away_m=4.2)
GONE_AND_BACK = tuple(((0.5, 2.0, 10.0)[n % 3], (0.0, 0.3, 1.0)[(n + n // 3) % 3]) for n in range(9))
CLOSURES = (moved(x=0.5), moved(y=2.0), map_turned(10.0))
ORIGINS = (other_origin(yaw_deg=30.0), other_origin(z=0.3), other_origin(x=2.0), other_origin(y=-2.0))
FROM_BOOT = Onset((0.0, 0.0), at_boot=True)
_EXCHANGED = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
GROUND_AXES: tuple[Callable[[], Injector], ...] = (
    lambda: AlteredImu(imu_axes((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))),
    lambda: AlteredImu(imu_axes((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))),
    lambda: AlteredPoses(body_turned(UPSIDE_DOWN)),
    lambda: AlteredPoses(body_turned((math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0))),
)
CLIMB_AXES: tuple[Callable[[], Injector], ...] = (
    lambda: AlteredPoses(ned),
    lambda: AlteredPoses(height_negated),
    lambda: CameraTurned(UPSIDE_DOWN),
)
LEVEL_AXES: tuple[Callable[[], Injector], ...] = (
    lambda: AlteredPoses(body_turned(LEFT)),
    lambda: CameraTurned(LEFT),
    lambda: AlteredImu(imu_axes(*_EXCHANGED)),
)
SPOILT = tuple(
    invalid(k) for k in ("nan place", "inf place", "nan turn", "zero turn", "long turn", "nan variance", "nan stamp")
)
NEAR_FLOOR = Room(clear_m=0.02)  # paths keep 0.3 m from the floor, of which the autopilot's own motion takes most
# Inertial samples continue the pose over the 0.33 s that B10 needs; pose_lost_s ends that. A constant pose must not be sent.
NEVER_REPEATS = (
    Limit("ODOMETRY ends", odometry_metrics.poses_until, 0.5, "s"),
    Limit("change of the pose error", odometry_metrics.pose_error_step(), 0.05, "m"),
)
# A drift that depth can see is corrected, or it ends the flight.
NEVER_ASTRAY = (clear(0.10), Limit("flown while off by 0.3 m", odometry_metrics.wrong_and_flown(), 0.5, "s"))
DRIFTS = tuple(((v, 0.0), (0.0, v), (-v, 0.0), (0.0, -v)) for v in (0.01, 0.02, 0.05, 0.1, 0.2))
# Where the poses are honest, no fault of the inertial sensor ends a flight.
HONEST_POSES = (
    Limit("change of the pose error", odometry_metrics.pose_error_step(), 0.25, "m"),
    clear(0.10),
    COMPLETES,
    NO_FAILSAFE,
)

TABLE_B = (
    Scenario(
        "B1",
        "pose stops",
        "no more poses, during fast flight",
        lambda n: [PoseSilence()],
        (
            holds(0.3),
            lands(1.2, ardupilot=1.9),  # from rest: it swings back after a brake
            Limit("drift", m.drift_landing, 0.8, "m"),
            down(30.0),
            reports(codes.NO_POSE, codes.POSE_STALE, within_s=1.3),
            *NEVER_REPEATS,
        ),
        onset=FAST,
        times=3,
    ),
    Scenario(
        "B1s",
        "pose stops over furniture",
        "no more poses, during fast flight above a stage 0.6 m high, on which it lands",
        lambda n: [PoseSilence()],
        (
            holds(0.3),
            lands(1.2, ardupilot=1.9),  # from rest: it swings back after a brake
            down(30.0),
            Limit("height at rest", m.rests_at, 0.55, "m", at_least=True),
        ),
        onset=ON_STAGE,
        arena="stage",
    ),
    Scenario(
        "B2",
        "pose comes back",
        "no pose for 0.5, 2, 10 s; then with an offset of 0, 0.3, 1 m",
        lambda n: [
            PoseSilence(GONE_AND_BACK[n % 9][0]),
            AlteredPoses(moved(x=GONE_AND_BACK[n % 9][1]), from_s=GONE_AND_BACK[n % 9][0]),
        ],
        (NO_JUMP, Limit("time steps in our mode after a landing", m.relaunched, 0.0, "")),
    ),
    Scenario(
        "B3",
        "pose spike",
        "one pose with an error of 0.5 m",
        lambda n: [AlteredPoses(moved(x=0.5), count=1)],
        (Limit("change of the pose error", odometry_metrics.pose_error_step(2.0), 0.05, "m"), NO_FAILSAFE),
        observe_s=12.0,
    ),
    Scenario(
        "B4",
        "pose jumps and stays",
        "every pose with an error of 0.5 m; of 2 m; odom rotated by 10 degrees",
        lambda n: [AlteredPoses(CLOSURES[n % 3])],
        (
            Limit("step of ODOMETRY", odometry_metrics.pose_step, 0.05, "m"),
            Limit("change of the pose error", odometry_metrics.pose_error_step(10.0), 0.10, "m"),
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
        (clear(0.10), reports(codes.SOURCE_EXCLUDED, *codes.DRIFT, within_s=10.0)),
        observe_s=80.0,
        camera="small",
    ),
    Scenario(
        "B5c",
        "pose drifts, and the tracker beside it corrects",
        "0.01, 0.02, 0.05, 0.1, 0.2 m/s for a minute along either axis, up to 3 m",
        lambda n: [AlteredPoses(drifting(*DRIFTS[n % 5][n % 4]))],
        NEVER_ASTRAY,
        observe_s=80.0,
        camera="small",
        poses="corrected",
    ),
    Scenario(
        "B6",
        "height drifts",
        "0.05, 0.02 m/s for a minute, up or down, up to 3 m",
        lambda n: [AlteredPoses(drifting(z=(0.05, -0.05, 0.02, -0.02)[n % 4]))],
        NEVER_ASTRAY,
        observe_s=80.0,
        camera="small",
        poses="corrected",
    ),
    Scenario(
        "B6s",
        "wrong scale of the poses",
        "ways too long or too short by 10, 5 %, from boot",
        lambda n: [AlteredPoses(scaled((0.9, 1.1, 0.95, 1.05)[n % 4]))],
        NEVER_ASTRAY,
        onset=FROM_BOOT,
        observe_s=120.0,
        camera="small",
        poses="corrected",
    ),
    Scenario(
        "B7",
        "invalid poses",
        "NaN, infinite, zero or too long values in each field",
        lambda n: [AlteredPoses(SPOILT[n % len(SPOILT)])],
        (
            Limit("NaN on the wire", lambda e: float(e.wire.not_finite), 0.0, ""),
            holds(0.3),
            lands(1.2, ardupilot=1.9),
            *NEVER_REPEATS,
        ),
        onset=FAST,
    ),
    Scenario(
        "B8",
        "late poses",
        "poses 0.1 s late",
        lambda n: [LatePoses(0.1)],
        (
            Limit("oldest pose sent", odometry_metrics.pose_age, 0.15, "s"),
            Limit("change of the pose error", odometry_metrics.pose_error_step(), 0.05, "m"),
            NO_FAILSAFE,
        ),
        onset=FAST,
        observe_s=15.0,
    ),
    Scenario(
        "B8l",
        "old or wrong timestamps",
        "poses 0.3, 1 s late; a frozen timestamp; 5 s in the future",
        lambda n: [(LatePoses(0.3), LatePoses(1.0), FrozenPose(), AlteredPoses(stamped(5.0)))[n % 4]],
        (
            Limit("oldest pose sent", odometry_metrics.pose_age, 0.15, "s"),
            Limit("change of the pose error", odometry_metrics.pose_error_step(), 0.10, "m"),  # as B4: kept through the braking
            holds(0.3),
            lands(1.2, ardupilot=1.9),  # from rest: it swings back after a brake
        ),
        onset=FAST,
    ),
    Scenario(
        "B9",
        "heading flips once",
        "one pose rotated by 180, 90, 15 degrees",
        lambda n: [AlteredPoses(turned((180.0, 90.0, 15.0)[n % 3]), count=1)],
        (
            Limit("change of the pose error", odometry_metrics.pose_error_step(2.0), 0.05, "m"),
            Limit("heading error", odometry_metrics.heading_error_step(2.0), 2.0, "deg"),
            NO_FAILSAFE,
        ),
        observe_s=12.0,
    ),
    Scenario(
        "B9p",
        "heading flips permanently",
        "every pose rotated by 180, 90, 15 degrees",
        lambda n: [AlteredPoses(turned((180.0, 90.0, 15.0)[n % 3]))],
        (lands(1.5), Limit("distance from the path", m.off_its_way, 0.3, "m"), Limit("drift", m.drift_landing, 0.8, "m")),
    ),
    Scenario(
        "B10",
        "few poses",
        "6 poses per second",
        lambda n: [ThinnedPoses(6.0)],
        (
            Limit("ODOMETRY in a second", odometry_metrics.pose_rate, 25.0, "1/s", at_least=True),
            Limit("speed 1 s later", m.speed_from(2.0), 0.3, "m/s"),  # after the one second over which the rate is measured
        ),
        observe_s=15.0,
    ),
    Scenario(
        "B10b",
        "too few poses",
        "3 poses per second, during fast flight",
        lambda n: [ThinnedPoses(3.0)],
        (
            # none while the newest pose is older than 0.25 s: until few poses are recognised, odometry counts as lost
            Limit("ODOMETRY in a second", odometry_metrics.pose_rate, 12.0, "1/s", at_least=True),
            holds(2.0),  # the rate is measured over one second
            Limit("speed from 3 s on", m.speed_from(3.0), 0.02, "m/s"),
        ),
        onset=FAST,
        observe_s=15.0,
    ),
    Scenario(
        "B11",
        "nothing to track",
        "darkness, blank wall, blur",
        why="needs visual tracking, which is not included",
    ),
    Scenario(
        "B12",
        "wrong vertical of IMU or poses",
        "from boot: the IMU in FRD; its x and z exchanged; poses of a body upside down; of one turned by 90 degrees about x",
        lambda n: [GROUND_AXES[n % 4]()],
        (NEVER_ARMED,),
        onset=FROM_BOOT,
        observe_s=30.0,
    ),
    Scenario(
        "B12c",
        "wrong vertical axis of poses or camera",
        "from boot: poses in NED of a body in FRD; height with the wrong sign; camera and its IMU upside down",
        lambda n: [CLIMB_AXES[n % 3]()],
        (Limit("height at the landing mode", m.height_at_landing, 0.6, "m"), clear(0.10)),
        onset=FROM_BOOT,
        observe_s=60.0,
    ),
    Scenario(
        "B12l",
        "wrong level axes of poses, camera or gyro",
        "from boot: poses of a body turned left by 90 degrees; the camera turned so; the gyro's x and y exchanged",
        lambda n: [LEVEL_AXES[n % 3]()],
        (clear(0.10), reports(*codes.AXES, within_s=60.0)),
        onset=FROM_BOOT,
        observe_s=90.0,
    ),
    Scenario(
        "B13",
        "autopilot's vertical velocity off",
        "the autopilot's vertical velocity reads 0.5, 0.3 m/s too high or too low in the air; its height is right",
        lambda n: [VerticalVelocityError((0.5, -0.5, 0.3, -0.3)[n % 4])],
        (holds(1.5), lands(2.0), down(40.0), reports(codes.ESTIMATE_VELOCITY, within_s=2.5), STREAMS, NO_FAILSAFE),
        onset=FAST,
        room=NEAR_FLOOR,
    ),
    Scenario(
        "B13h",
        "autopilot's height datum moves",
        "the autopilot's height jumps by 0.5 m up or down and stays",
        lambda n: [HeightDatumMoved((0.5, -0.5)[n % 2])],
        (holds(1.0), lands(1.5), down(40.0), reports(codes.ESTIMATE_POSITION, within_s=2.0), STREAMS, NO_FAILSAFE),
        onset=FAST,
        room=NEAR_FLOOR,
    ),
    Scenario(
        "B14",
        "no inertial samples",
        "no inertial sample, from boot",
        lambda n: [ImuSilence()],
        (
            Limit("reported after the arm command", statustext_after_arm_command(*codes.NO_IMU), 1.0, "s"),
            clear(0.10),
            COMPLETES,
            NO_FAILSAFE,
        ),
        onset=Onset((0.0, 0.0), at_boot=True),
        observe_s=480.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "B14d",
        "inertial samples end",
        "the inertial samples end during fast flight",
        lambda n: [ImuSilence()],
        (
            reports(*codes.NO_IMU, within_s=1.0),
            Limit("speed 1 s later", m.speed_from(1.0), 0.35, "m/s"),
            clear(0.10),
            COMPLETES,
            NO_FAILSAFE,
        ),
        onset=FAST,
        observe_s=480.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "B15",
        "accelerometer clips",
        "specific force times 0.51, 0.8, 0.9 from the end of the climb on, as under vibration",
        lambda n: [AlteredImu(scaled_force((0.51, 0.8, 0.9)[n % 3]))],
        HONEST_POSES,
        onset=AT_ONCE,
        observe_s=480.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "B15o",
        "accelerometer off",
        "specific force off by 1, 2, 4, 8 m/s² along x or y, permanently",
        lambda n: [AlteredImu(offset_force(*OFFSETS[n % 8]))],
        HONEST_POSES,
        onset=FAST,
        observe_s=480.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "B15t",
        "accelerometer off for a moment",
        "specific force off by 4 m/s² for 1 s, by 8 m/s² for 0.5 s",
        lambda n: [AlteredImu(offset_force(*((4.0, 0.0), (0.0, 8.0))[n % 2]), for_s=(1.0, 0.5)[n % 2])],
        HONEST_POSES,
        onset=FAST,
        observe_s=480.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "B15f",
        "inertial values repeat",
        "the values of accelerometer, of gyro, of both are frozen during fast flight",
        lambda n: [FrozenImu(gyro=n % 3 != 0, accelerometer=n % 3 != 1)],
        (reports(*codes.IMU_FROZEN, within_s=1.0), *HONEST_POSES),
        onset=FAST,
        observe_s=480.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "B15v",
        "vibration",
        "white noise of 3 m/s² on each axis of the accelerometer",
        lambda n: [AlteredImu(vibration(3.0))],
        HONEST_POSES,
        onset=AT_ONCE,
        observe_s=480.0,
        views=SHORT_VIEWS,
    ),
    Scenario(
        "B16",
        "origin is not the pad",
        "a pose source whose origin is rotated by 30 degrees, lowered by 0.3 m, or 2 m beside the pad, from boot",
        lambda n: [AlteredPoses(ORIGINS[n % 4])],
        (
            Limit("ODOMETRY off the world at the pad", odometry_metrics.pose_error_armed, 0.15, "m"),
            clear(0.10),
            COMPLETES,
            NO_FAILSAFE,
        ),
        onset=Onset((0.0, 0.0), at_boot=True),
        observe_s=240.0,
        views=SHORT_VIEWS,
    ),
)
