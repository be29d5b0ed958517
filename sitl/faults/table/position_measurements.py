"""Table H: one of the three measurements of the motion is wrong, the two others are honest.

The three are the pose source, the inertial sensors and the view (depth and colour). Whichever two agree fly on.
"""

from __future__ import annotations

import functools

from sitl.faults import reason_codes as codes
from sitl.faults.fault import Onset
from sitl.faults.injectors.base import Injector
from sitl.faults.injectors.depth_camera import (
    AlteredDepth,
    EveryNthFrame,
    ScatteredFrames,
    ShiftedTimestamps,
    constant,
    false_wall,
    thinned,
)
from sitl.faults.injectors.inertial_sensor import (
    AlteredImu,
    FrozenImu,
    ImuSilence,
    clipped_gyro,
    offset_force,
    offset_gyro,
    scaled_force,
)
from sitl.faults.injectors.mavlink_link import PacketLoss
from sitl.faults.injectors.pose_stream import AlteredPoses, CoastingPoses, RestartedSource, other_origin
from sitl.faults.injectors.vehicle_and_autopilot import HEADING_OFF, HeadingError, PropellerTouch
from sitl.faults.judges import reaction_metrics as m
from sitl.faults.judges.statustext_checks import landed_by_alarm, statustext_after_arm_command
from sitl.faults.table.acceptance_limits import COMPLETES, NEVER_ARMED, clear, down, holds, reports
from sitl.faults.table.scenario import Limit, Scenario

MOVING = Onset(speed_mps=0.3)
FROM_BOOT = Onset((0.0, 0.0), at_boot=True)
AFTER_TAKEOFF = Onset((0.0, 0.5), speed_mps=0.0)
ODOMETRY = 331  # MAVLink message
UNFED = (codes.ESTIMATE_POSITION, codes.ESTIMATE_VELOCITY, codes.AUTOPILOT_LANDS)
EMPTY_S = (0.3, 0.5, 1.0, 3.0)
STANDS_S = (0.5, 1.0, 2.0, 5.0)
COASTS_S = 5.0
CLAIMED_M = 0.05
FLIES_ON = (clear(0.10), COMPLETES, Limit("flights ended by an alarm", landed_by_alarm, 0.0, ""))
# offset (m/s²) of the accelerometer along x and y, and for how long (s)
FOR_GOOD_S = 1e9
OFFSETS = ((2.0, 0.0, 0.5), (0.0, 1.0, FOR_GOOD_S), (0.0, 2.0, 0.5), (1.0, 0.0, FOR_GOOD_S))
STRONG_OFFSETS = ((2.0, 0.0), (0.0, 4.0), (0.0, 2.0), (4.0, 0.0))

OUTSIDE = functools.partial(Scenario, arena="room", onset=MOVING, observe_s=240.0, views=24)
CHECKED = functools.partial(OUTSIDE, camera="small")  # the view checks the source: it needs colour where walls are bare
BY_SLAM = functools.partial(OUTSIDE, poses="slam", camera="d435i", views=16)  # images at 6 Hz are too few for it

TABLE_H = (
    CHECKED(
        "H0",
        "no fault",
        "none: the flight that the other scenarios of this table share until their faults",
        limits=FLIES_ON,
    ),
    BY_SLAM(
        "H0s",
        "no fault, by the embedded SLAM",
        "none: the flight that the other scenarios by the embedded SLAM share until their faults",
        limits=FLIES_ON,
    ),
    CHECKED(
        "H1",
        "translation of the pose source stands still",
        "positions stand still for 0.5, 1, 2, 5 s while the vehicle moves, attitudes are right; the source claims 1 cm",
        lambda n: [CoastingPoses(STANDS_S[n % 4], share=0.0)],
        FLIES_ON,
    ),
    CHECKED(
        "H1c",
        "as H1, the source claims 5 cm",
        "as H1, with a claimed standard deviation of 5 cm",
        lambda n: [CoastingPoses(STANDS_S[n % 4], share=0.0)],
        FLIES_ON,
        claimed_m=CLAIMED_M,
    ),
    OUTSIDE(
        "H1d",
        "as H1, and the tracker beside the source corrects",
        "as H1, with localization.correct_drift",
        lambda n: [CoastingPoses(STANDS_S[n % 4], share=0.0)],
        FLIES_ON,
        poses="corrected",
        camera="small",
    ),
    CHECKED(
        "H2",
        "pose source coasts",
        "positions go on for 5 s at the velocity of the beginning, attitudes are right; the source claims 1 cm",
        lambda n: [CoastingPoses(COASTS_S)],
        FLIES_ON,
    ),
    CHECKED(
        "H2c",
        "as H2, the source claims 5 cm",
        "as H2, with a claimed standard deviation of 5 cm",
        lambda n: [CoastingPoses(COASTS_S)],
        FLIES_ON,
        claimed_m=CLAIMED_M,
    ),
    CHECKED(
        "H3",
        "pose source starts again",
        "its frame begins again at the vehicle, position and heading: uncounted; counted; or it moves by 1 m and 14 degrees, "
        "uncounted",
        lambda n: [
            (
                RestartedSource(counted=False),
                RestartedSource(counted=True),
                AlteredPoses(other_origin(yaw_deg=14.0, x=1.0)),
            )[n % 3]
        ],
        FLIES_ON,
    ),
    CHECKED(
        "H4",
        "accelerometer off, the source claims 4.5 cm",
        "specific force off by 2 m/s² for 0.5 s, by 1 m/s² permanently, along x or y; the source claims 4.5 cm",
        lambda n: [AlteredImu(offset_force(*OFFSETS[n % 4][:2]), for_s=OFFSETS[n % 4][2])],
        FLIES_ON,
        claimed_m=0.045,
    ),
    BY_SLAM(
        "H5",
        "accelerometer off, by the embedded SLAM",
        "specific force off by 2, 4 m/s² along x or y, permanently",
        lambda n: [AlteredImu(offset_force(*STRONG_OFFSETS[n % 4]))],
        (*FLIES_ON, reports(*codes.ACCELEROMETER_WRONG, within_s=1.3)),
    ),
    BY_SLAM(
        "H5m",
        "accelerometer off a little, by the embedded SLAM",
        "specific force off by 2 m/s² for 0.5 s, by 1 m/s² permanently, along x or y",
        lambda n: [AlteredImu(offset_force(*OFFSETS[n % 4][:2]), for_s=OFFSETS[n % 4][2])],
        FLIES_ON,
    ),
    BY_SLAM(
        "H5d",
        "inertial samples end, by the embedded SLAM",
        "no more inertial samples",
        lambda n: [ImuSilence()],
        (*FLIES_ON, reports(*codes.NO_IMU, within_s=1.0)),
    ),
    BY_SLAM(
        "H5n",
        "no inertial samples, by the embedded SLAM",
        "no inertial sample, from boot",
        lambda n: [ImuSilence()],
        (*FLIES_ON, Limit("reported after the arm command", statustext_after_arm_command(*codes.NO_IMU), 1.0, "s")),
        onset=FROM_BOOT,
        observe_s=300.0,
    ),
    BY_SLAM(
        "H5f",
        "inertial values repeat, by the embedded SLAM",
        "the values of the gyro, of gyro and accelerometer are frozen",
        lambda n: [FrozenImu(accelerometer=n % 2 == 1)],
        (*FLIES_ON, reports(*codes.IMU_FROZEN, within_s=1.0)),
    ),
    BY_SLAM(
        "H5s",
        "accelerometer clips, by the embedded SLAM",
        "specific force times 0.51 from the end of the climb on",
        lambda n: [AlteredImu(scaled_force(0.51))],
        (*FLIES_ON, reports(*codes.ACCELEROMETER_WRONG, within_s=1.3)),
        onset=AFTER_TAKEOFF,
    ),
    BY_SLAM(
        "H5g",
        "gyro off, by the embedded SLAM",
        "angular rate off by 0.05 rad/s about x, y, z, permanently",
        lambda n: [AlteredImu(offset_gyro(*(0.05 if axis == n % 3 else 0.0 for axis in range(3))))],
        FLIES_ON,
    ),
    BY_SLAM(
        "H6",
        "propeller touches a wall, by the embedded SLAM",
        "the vehicle is tilted by 10 degrees and pushed by 60 m/s² for 10 ms; the gyro clips at 250 degrees/s; it does not",
        lambda n: [PropellerTouch(10.0, 60.0, 0.01), *([] if n % 2 else [AlteredImu(clipped_gyro(250.0))])],
        FLIES_ON,
    ),
    BY_SLAM(
        "H7",
        "depth empty or sparse for a moment, by the embedded SLAM",
        "no returns for 0.3, 0.5, 1, 3 s; in every fifth frame; in every third frame returns in 10 % of the pixels",
        lambda n: [_gaps(n)],
        FLIES_ON,
    ),
    OUTSIDE(
        "H7o",
        "depth empty or sparse for a moment",
        "as H7, with poses from outside",
        lambda n: [_gaps(n)],
        FLIES_ON,
    ),
    OUTSIDE(
        "H8",
        "false wall in the depth",
        "a wall of 1 x 1 m, 1.2 m ahead, in 15 %, in 3 % of the frames",
        lambda n: [ScatteredFrames(false_wall(1.0, 1.2), (0.15, 0.03)[n % 2], n)],
        FLIES_ON,
    ),
    OUTSIDE(
        "H8c",
        "depth clock steps back",
        "time stamps of the images earlier by 0.2, 0.8 s from then on",
        lambda n: [ShiftedTimestamps((-0.2, -0.8)[n % 2])],
        FLIES_ON,
    ),
    OUTSIDE(
        "H8e",
        "every fifth frame empty at 6 Hz",
        "no returns in every fifth frame of a camera with six images a second",
        lambda n: [EveryNthFrame(constant(0), 5)],
        FLIES_ON,
    ),
    OUTSIDE(
        "H9",
        "autopilot's heading turns by itself",
        "the autopilot's estimate of its heading turns away by 3, 1 degrees/s in the air; it reports and flies by it",
        lambda n: [HeadingError(rate_degps=(3.0, 1.0)[n % 2])],
        (
            Limit("hold after 10 degrees", m.from_note(HEADING_OFF, m.held_after()), 3.0, "s"),
            Limit("disarmed after 10 degrees", m.from_note(HEADING_OFF, m.disarmed_after()), 40.0, "s"),
            clear(0.10),
        ),
        observe_s=90.0,
    ),
    OUTSIDE(
        "H9g",
        "autopilot's heading is off on the ground",
        "from boot, the autopilot's estimate of its heading is off by 180, 45 degrees",
        lambda n: [HeadingError(offset_deg=(180.0, 45.0)[n % 2])],
        (NEVER_ARMED,),
        onset=FROM_BOOT,
        observe_s=60.0,
    ),
    OUTSIDE(
        "H10",
        "autopilot drops the odometry in the air",
        "no ODOMETRY reaches the autopilot's estimator any more, while all other messages do",
        lambda n: [PacketLoss("up", only=(ODOMETRY,))],
        (holds(3.0), down(40.0), clear(0.10), reports(*UNFED, within_s=4.0)),
        observe_s=60.0,
    ),
)


def _gaps(n: int) -> Injector:
    """Return the n-th case of missing depth."""
    if n % 6 < len(EMPTY_S):
        return AlteredDepth(constant(0), EMPTY_S[n % 6])
    return EveryNthFrame(constant(0), 5) if n % 6 == len(EMPTY_S) else EveryNthFrame(thinned(0.1), 3)
