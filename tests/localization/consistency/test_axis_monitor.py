"""Wrong axes or signs are found on the ground or in the first half metre of climb; bad sensors are not taken for them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from textured_room import BARE, depth_of, frame_of

from uav_recon.localization.consistency.axis_monitor import ASSIGNMENTS, AxisMonitor
from uav_recon.types.camera import Frame, ImuSample, body_from_camera
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

ROOM_M = np.array([[-3.5, -2.5, 0.0], [3.5, 2.5, 2.6]])
CABINET_M = np.array([[1.8, 0.9, 0.0], [2.4, 1.6, 1.9]])
BODY_FROM_DEPTH = body_from_camera(np.array([0.1, 0.0, 0.0]), math.radians(15.0))
LIFT_S = 2.0
GRAVITY = np.array([0.0, 0.0, 9.81])
TURN_LEFT = Pose.from_yaw(math.pi / 2, np.zeros(3))
UPSIDE_DOWN = Pose(np.array([0.0, 1.0, 0.0, 0.0]), np.zeros(3))  # also FRD seen from FLU

Change = Callable[[StampedPose], StampedPose]


def _ramp(t: float, begin_s: float, end_s: float) -> float:
    """From 0 to 1, with acceleration and brake."""
    x = min(max((t - begin_s) / (end_s - begin_s), 0.0), 1.0)
    return x * x * (3.0 - 2.0 * x)


def _place(t: float) -> FloatArray:
    """At rest, climb of 1 m, then a flight to and fro."""
    along = max(t - 8.0, 0.0)
    return np.array([0.8 * math.sin(0.6 * along), 0.5 * math.sin(0.8 * along), 0.1 + _ramp(t, LIFT_S, LIFT_S + 3.0)])


def _body(t: float) -> Pose:
    """Leans as it accelerates and trembles a little; turns by 90 degrees after the climb."""
    h = 0.05
    push = (_place(t + h) - 2 * _place(t) + _place(t - h)) / h**2 + GRAVITY
    tremble = math.radians(0.4) * _ramp(t, LIFT_S, LIFT_S + 0.5)
    lean = Rotation.from_euler("xyz", [-math.atan2(push[1], push[2]), math.atan2(push[0], push[2]), 0.0])
    shake = Rotation.from_rotvec([tremble * math.sin(5.0 * t), tremble * math.cos(4.0 * t), 0.0])
    yaw = Rotation.from_euler("z", math.pi / 2 * _ramp(t, 5.5, 8.5))
    turn = lean * yaw * shake
    return Pose(turn.as_quat(scalar_first=True), _place(t))


def _imu(t: float, rng: np.random.Generator) -> ImuSample:
    h = 1e-3
    before, here, after = (Rotation.from_quat(_body(t + k * h).quat_wxyz, scalar_first=True) for k in (-1, 0, 1))
    h_m = 0.02
    acceleration = (_place(t + h_m) - 2 * _place(t) + _place(t - h_m)) / h_m**2
    noise = rng.standard_normal((2, 3)) * ([[0.01], [0.5]] if t > LIFT_S else [[0.001], [0.03]])
    gyro = (before.inv() * after).as_rotvec() / (2 * h) + 0.004 + noise[0]
    return ImuSample(t, gyro, here.inv().apply(acceleration + GRAVITY) + 0.1 + noise[1])


@dataclass(frozen=True)
class Wrong:
    """What is wrong: poses, mount (true_from_configured on the body), and assignment of the IMU's axes."""

    pose: Change = lambda pose: pose
    mount: Pose = field(default_factory=Pose.identity)
    gyro: FloatArray = field(default_factory=lambda: np.eye(3))
    force: FloatArray = field(default_factory=lambda: np.eye(3))
    force_offset: FloatArray = field(default_factory=lambda: np.zeros(3))
    delay_s: float = 0.0


@dataclass(frozen=True)
class Found:
    """When it was found, how high the vehicle was above the ground then, and the reason."""

    at_s: float
    climbed_m: float
    moved_m: float
    reason: Reason


def _fly(wrong: Wrong, seconds: float = 14.0, seed: int = 0, *, every: int = 5) -> Found | None:
    """Poses at 15 Hz; frames at 30 Hz divided by every."""
    monitor, rng = AxisMonitor(), np.random.default_rng(seed)
    for n in range(round(seconds * 30)):
        t = n / 30
        samples = [_imu(t + k / 120, rng) for k in range(-3, 1)]
        monitor.add_imu(
            [
                ImuSample(s.stamp_s, wrong.gyro @ s.gyro_radps, wrong.force @ s.specific_force_mps2 + wrong.force_offset)
                for s in samples
            ]
        )
        if n % every == 0:
            monitor.add_frame(_frame(t, wrong, n), BODY_FROM_DEPTH)
        if n % 2 == 0:
            noise_m = 0.003 * rng.standard_normal(3)
            lean = Pose.from_rotation_vector(math.radians(0.1) * rng.standard_normal(3), noise_m)
            true = _body(t)
            pose = Pose((lean @ true).quat_wxyz, true.translation_m + noise_m)
            monitor.add_pose(wrong.pose(StampedPose(t, pose, np.zeros(3))))
        if monitor.reason is not None:
            moved_m = float(np.linalg.norm(_place(t)[:2]))
            return Found(t, float(_place(t)[2] - 0.1), moved_m, monitor.reason)
    return None


def _frame(t: float, wrong: Wrong, seed: int) -> Frame:
    camera = _body(t - wrong.delay_s) @ wrong.mount @ BODY_FROM_DEPTH
    return frame_of(t, depth_of(camera, ROOM_M, CABINET_M, seed=seed), BARE)


def _turned(turn: Pose) -> Change:
    """The body's axes of the poses are turned against the true ones."""
    return lambda pose: replace(pose, odom_from_body=pose.odom_from_body @ turn)


def _ned(pose: StampedPose) -> StampedPose:
    """NED from FRD in place of ENU from FLU."""
    there = UPSIDE_DOWN @ pose.odom_from_body @ UPSIDE_DOWN
    return replace(pose, odom_from_body=there)


def _placed(assignment: FloatArray) -> Change:
    """The axes of the position alone are exchanged."""
    return lambda pose: replace(
        pose, odom_from_body=Pose(pose.odom_from_body.quat_wxyz, assignment @ pose.odom_from_body.translation_m)
    )


SMALL = Pose.from_rotation_vector(np.radians([1.0, -1.0, 1.0]), np.array([0.01, -0.01, 0.01]))


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.nightly), pytest.param(2, marks=pytest.mark.nightly)])
@pytest.mark.parametrize(
    "wrong",
    [
        Wrong(),
        Wrong(mount=SMALL, delay_s=0.04, force_offset=np.array([0.1, -0.1, 0.1])),
        Wrong(mount=SMALL.inverse(), delay_s=-0.02),
        Wrong(pose=lambda pose: replace(pose, odom_from_body=TURN_LEFT @ pose.odom_from_body)),  # another heading of odom
    ],
)
def test_an_honest_camera_never_alarms(wrong: Wrong, seed: int) -> None:
    assert _fly(wrong, seed=seed) is None


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_drift_of_the_poses_is_not_taken_for_wrong_axes(axis: int) -> None:
    away = np.eye(3)[axis] * 0.08
    drifting = Wrong(
        pose=lambda p: replace(
            p,
            odom_from_body=Pose(
                p.odom_from_body.quat_wxyz, p.odom_from_body.translation_m + away * max(p.stamp_s - LIFT_S, 0.0)
            ),
        )
    )
    assert _fly(drifting) is None


def test_an_accelerometer_with_an_offset_is_not_taken_for_wrong_axes() -> None:
    assert _fly(Wrong(force_offset=np.array([2.0, 0.0, 0.0]))) is None


GROUND = {
    "IMU in FRD": Wrong(gyro=np.diag([1.0, -1.0, -1.0]), force=np.diag([1.0, -1.0, -1.0])),
    "IMU's x and z exchanged": Wrong(force=np.array([[0.0, 0, 1], [0, 1, 0], [1, 0, 0]])),
    "poses of the optical frame": Wrong(pose=_turned(BODY_FROM_DEPTH)),
    "poses upside down": Wrong(pose=_turned(UPSIDE_DOWN)),
}


@pytest.mark.parametrize("name", GROUND)
def test_a_wrong_vertical_is_found_on_the_ground(name: str) -> None:
    found = _fly(GROUND[name])
    assert found is not None
    assert found.at_s < LIFT_S
    assert found.reason.code is ReasonCode.AXES_GRAVITY


MOTION = {ReasonCode.AXES_DEPTH, ReasonCode.AXES_FORCE}
CLIMB = {
    "poses in NED and FRD": Wrong(pose=_ned),
    "height with the wrong sign": Wrong(pose=_placed(np.diag([1.0, 1.0, -1.0]))),
    "position's x and z exchanged": Wrong(pose=_placed(np.array([[0.0, 0, 1], [0, 1, 0], [1, 0, 0]]))),
    "camera upside down": Wrong(mount=UPSIDE_DOWN),
}


@pytest.mark.parametrize("name", CLIMB)
def test_a_wrong_vertical_axis_is_found_within_half_a_metre_of_climb(name: str) -> None:
    found = _fly(CLIMB[name], every=2)
    assert found is not None
    assert 0.0 < found.climbed_m <= 0.5
    assert found.reason.code in MOTION


LEVEL = {
    "poses turned by 90 degrees": (Wrong(pose=_turned(TURN_LEFT)), MOTION | {ReasonCode.AXES_GYRO}),
    "camera turned by 90 degrees": (Wrong(mount=TURN_LEFT), MOTION),
    "position's x and y exchanged": (
        Wrong(pose=_placed(np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]))),
        MOTION,
    ),
    "gyro's x and y exchanged": (Wrong(gyro=np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]])), {ReasonCode.AXES_GYRO}),
    "gyro's x with the wrong sign": (Wrong(gyro=np.diag([-1.0, 1, 1])), {ReasonCode.AXES_GYRO}),
    "gyro's z with the wrong sign": (Wrong(gyro=np.diag([1.0, 1, -1])), {ReasonCode.AXES_GYRO}),
}


@pytest.mark.parametrize("name", LEVEL)
def test_level_axes_are_found_once_the_vehicle_turns_or_moves_level(name: str) -> None:
    wrong, codes = LEVEL[name]
    found = _fly(wrong, every=2)
    assert found is not None
    assert found.reason.code in codes
    assert found.moved_m <= (0.9 if "position" in name else 0.5)


def test_the_reason_names_the_axes() -> None:
    found = _fly(Wrong(pose=_turned(TURN_LEFT)))
    assert found is not None
    named = "-y x z" if found.reason.code is ReasonCode.AXES_GYRO else "y -x z"  # the x of the gyro is the -y of the poses
    assert found.reason.values == (named,)


def test_the_configured_assignment_is_the_first() -> None:
    np.testing.assert_array_equal(ASSIGNMENTS[0], np.eye(3))
    assert len({matrix.tobytes() for matrix in ASSIGNMENTS + 0.0}) == 48


def test_it_stays_reported() -> None:
    monitor = AxisMonitor()
    monitor.reason = Reason(ReasonCode.AXES_GRAVITY, (180.0,))
    monitor.add_pose(StampedPose(0.0, Pose.identity(), np.zeros(3)))
    assert monitor.reason == Reason(ReasonCode.AXES_GRAVITY, (180.0,))
