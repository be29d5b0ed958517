from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from figure_eight import Event, FigureEight, events
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from uav_recon.localization.fusion.filter_pose_gates import PoseRejection
from uav_recon.localization.fusion.fusion_filter import FusionFilter
from uav_recon.localization.fusion.imu_integration import GRAVITY_MPS2
from uav_recon.measurement.machine_speed import measure_machine_speed
from uav_recon.types.camera import ImuSample
from uav_recon.types.pose import Pose, PoseHealth, StampedPose

SETTLED_S = 5.0
MOTION = FigureEight()


def _rotation(pose: Pose) -> Rotation:
    return Rotation.from_quat(pose.quat_wxyz, scalar_first=True)


def _rms(rows: list[NDArray[np.float64]]) -> float:
    return float(np.sqrt((np.array(rows) ** 2).sum(axis=1).mean()))


def _feed(fusion: FusionFilter, event: Event) -> bool:
    if event.imu:
        fusion.add_imu([event.imu])
        return True
    assert event.pose
    return fusion.add_pose(event.pose, event.arrival_s)


class _Flight:
    """What the filter reported at 30 Hz, against the truth. Errors beyond the drift that no filter can know."""

    def __init__(self, seed: int, *, imu: bool = True, duration_s: float = 15.0) -> None:
        self.position: list[NDArray[np.float64]] = []
        self.velocity: list[NDArray[np.float64]] = []
        self.attitude: list[NDArray[np.float64]] = []
        self.frame: list[NDArray[np.float64]] = []
        self.steps_m: list[float] = []
        self.qualities: set[int] = set()
        fusion, due_s, drift = FusionFilter(), MOTION.start_s + SETTLED_S, np.zeros(6)
        for event in events(MOTION, duration_s, seed, imu=imu):
            while event.arrival_s > due_s:
                self._compare(fusion, due_s, drift)
                due_s += 1 / 30
            before = fusion.odom_at(event.arrival_s)
            assert _feed(fusion, event)
            drift = drift if event.drift is None else event.drift
            after = fusion.odom_at(event.arrival_s)
            if before and after and event.arrival_s > MOTION.start_s + SETTLED_S:
                step = after.odom_from_body.translation_m - before.odom_from_body.translation_m
                self.steps_m.append(float(np.linalg.norm(step)))
        assert not fusion.rejected

    def _compare(self, fusion: FusionFilter, now_s: float, drift: NDArray[np.float64]) -> None:
        now, past = fusion.odom_at(now_s), fusion.odom_at(now_s - 0.15)
        assert now
        assert past
        self.position.append(now.odom_from_body.translation_m - MOTION.position(now_s) - drift[:3])
        self.velocity.append(now.velocity_odom_mps - MOTION.velocity(now_s))
        truth = Rotation.from_rotvec(drift[3:]) * MOTION.attitude(now_s)
        self.attitude.append((_rotation(now.odom_from_body) * truth.inv()).as_rotvec())
        self.frame.append(past.odom_from_body.translation_m - MOTION.position(now_s - 0.15) - drift[:3])
        self.qualities.add(now.quality)


@pytest.mark.parametrize("seed", range(3))
def test_odometry_now_is_good_although_poses_are_late(seed: int) -> None:
    flight = _Flight(seed)
    assert _rms(flight.position) < 0.008  # promised 0.015
    assert _rms(flight.velocity) / np.sqrt(3) < 0.03
    assert np.degrees(_rms(flight.attitude)) < 0.25
    assert _rms(flight.frame) < 0.005
    assert max(flight.steps_m) < 0.012  # free of jumps
    assert flight.qualities == {100}


def test_without_an_imu_it_works_with_less_quality() -> None:
    flight = _Flight(1, imu=False)
    assert _rms(flight.position) < 0.02
    assert _rms(flight.velocity) / np.sqrt(3) < 0.1
    assert np.degrees(_rms(flight.attitude)) < 0.7
    assert _rms(flight.frame) < 0.006
    assert flight.qualities == {60}


def _warm(seed: int = 4, duration_s: float = 3.0) -> tuple[FusionFilter, list[Event]]:
    """A filter in flight, and what it is to get next."""
    fusion = FusionFilter()
    stream = events(MOTION, duration_s + 4.0, seed)
    cut = next(i for i, event in enumerate(stream) if event.arrival_s > MOTION.start_s + duration_s)
    for event in stream[:cut]:
        _feed(fusion, event)
    return fusion, stream[cut:]


def _pose(stamp_s: float, offset_m: float = 0.0, turn_rad: float = 0.0) -> StampedPose:
    truth = MOTION.pose(stamp_s)
    turned = Rotation.from_rotvec([0, 0, turn_rad]) * _rotation(truth)
    return StampedPose(
        stamp_s, Pose(turned.as_quat(scalar_first=True), truth.translation_m + np.array([offset_m, 0, 0])), np.zeros(3)
    )


NOW_S = MOTION.start_s + 3.0


@pytest.mark.parametrize(
    ("pose", "reason"),
    [
        (replace(_pose(NOW_S - 0.05), covariance=np.full((6, 6), np.nan)), PoseRejection.NOT_FINITE),
        (replace(_pose(NOW_S - 0.05), stamp_s=float("nan")), PoseRejection.NOT_FINITE),
        (replace(_pose(NOW_S - 0.05), stamp_s=float("inf")), PoseRejection.NOT_FINITE),
        (replace(_pose(NOW_S - 0.05), quality=0), PoseRejection.QUALITY),
        (_pose(NOW_S + 0.2), PoseRejection.STAMP),
        (_pose(NOW_S - 1.5), PoseRejection.STAMP),
        (replace(_pose(NOW_S - 0.05), stamp_s=0.0), PoseRejection.STAMP),
        (_pose(NOW_S - 0.05, offset_m=0.55), PoseRejection.JUMP),
        (_pose(NOW_S - 0.05, offset_m=-9e3), PoseRejection.JUMP),
        (_pose(NOW_S - 0.05, offset_m=-1e9), PoseRejection.OUT_OF_RANGE),
        (_pose(NOW_S - 0.05, turn_rad=0.6), PoseRejection.TURN),
    ],
)
def test_what_cannot_be_true_never_enters(pose: StampedPose, reason: PoseRejection) -> None:
    fusion, _ = _warm()
    before = fusion.odom_at(NOW_S)
    assert before
    assert not fusion.add_pose(pose, NOW_S)
    after = fusion.odom_at(NOW_S)
    assert after
    np.testing.assert_array_equal(before.odom_from_body.matrix(), after.odom_from_body.matrix())
    assert fusion.rejected == {reason: 1}


def test_what_a_source_claims_to_have_drifted_is_passed_on_within_reason() -> None:
    fusion = FusionFilter()
    for n in range(30):
        stamp_s = n / 15
        fusion.add_imu([ImuSample(stamp_s + k / 200, np.zeros(3), np.array([0.0, 0.0, GRAVITY_MPS2])) for k in range(14)])
        assert fusion.add_pose(replace(_pose_at(stamp_s), covariance=np.diag([1e4] * 6)), stamp_s)
    odom = fusion.odom_at(2.0)
    assert odom is not None
    assert np.all(odom.covariance.diagonal() < [100.0] * 3 + [10.0] * 3)
    assert np.all(odom.covariance.diagonal() > [80.0] * 3 + [8.0] * 3)


def test_a_duplicate_never_enters() -> None:
    fusion, _ = _warm()
    assert not fusion.add_pose(_pose(fusion.newest_pose_s, offset_m=0.02), NOW_S)
    assert fusion.rejected == {PoseRejection.DUPLICATE: 1}


def test_inertial_nonsense_never_enters() -> None:
    fusion, rest = _warm()
    newest = next(event.imu for event in rest if event.imu)
    zero, up = np.zeros(3), np.array([0.0, 0.0, 9.8])
    fusion.add_imu([newest])
    bad = [
        ImuSample(newest.stamp_s + 0.01, np.array([np.nan, 0, 0]), up),
        ImuSample(newest.stamp_s + 0.01, zero, np.array([np.inf, 0, 0])),
        ImuSample(float("nan"), zero, up),
        ImuSample(newest.stamp_s + 0.01, np.array([100.0, 0, 0]), up),
        ImuSample(newest.stamp_s + 0.01, zero, np.array([0.0, -160.1, 0.0])),
        newest,
        replace(newest, stamp_s=newest.stamp_s - 0.1),
        replace(newest, stamp_s=newest.stamp_s + 3600.0),
    ]
    before = fusion.odom_at(NOW_S + 0.03)
    fusion.add_imu(bad, newest.stamp_s + 0.02)
    after = fusion.odom_at(NOW_S + 0.03)
    assert before
    assert after
    np.testing.assert_array_equal(before.odom_from_body.matrix(), after.odom_from_body.matrix())
    assert fusion.rejected == {PoseRejection.IMU_NOT_FINITE: 4, PoseRejection.IMU_FORCE: 1, PoseRejection.IMU_STAMP: 3}


def test_poses_out_of_order_end_in_the_same_place() -> None:
    """A pose that overtakes another changes nothing: each is put at its own stamp."""
    ordered, rest = _warm()
    swapped, _ = _warm()
    poses = [event.pose for event in rest if event.pose][:4]
    for fusion in (ordered, swapped):
        fusion.add_imu([event.imu for event in rest if event.imu and event.imu.stamp_s < NOW_S + 0.5])
    for k in (0, 1, 2, 3):
        assert ordered.add_pose(poses[k], NOW_S + 0.3)
    for k in (0, 2, 1, 3):
        assert swapped.add_pose(poses[k], NOW_S + 0.3)
    a, b = ordered.odom_at(NOW_S + 0.3), swapped.odom_at(NOW_S + 0.3)
    assert a
    assert b
    np.testing.assert_allclose(a.odom_from_body.matrix(), b.odom_from_body.matrix(), atol=1e-3)
    np.testing.assert_allclose(a.velocity_odom_mps, b.velocity_odom_mps, atol=1e-2)


def test_the_way_is_continuous_across_poses() -> None:
    fusion, _ = _warm()
    stamps = np.arange(NOW_S - 1.0, NOW_S, 0.001)
    track = []
    for stamp_s in stamps:
        odom = fusion.odom_at(float(stamp_s))
        assert odom
        track.append(odom.odom_from_body.translation_m)
    assert np.linalg.norm(np.diff(track, axis=0), axis=1).max() < 0.0015  # 0.8 m/s is 0.8 mm


def test_quality_falls_to_zero_without_poses() -> None:
    fusion, rest = _warm()
    fusion.add_imu([event.imu for event in rest if event.imu])
    newest_s = fusion.newest_pose_s
    qualities = []
    for age_s in (0.1, 0.3, 0.45, 0.49, 0.51, 2.0):
        odom = fusion.odom_at(newest_s + age_s)
        assert odom
        qualities.append(odom.quality)
    assert qualities[0] == 100
    assert qualities == sorted(qualities, reverse=True)
    assert qualities[3] > 0
    assert qualities[4:] == [0, 0]


def test_a_short_gap_is_bridged_by_the_imu() -> None:
    fusion, rest = _warm()
    gap_end_s = NOW_S + 0.5
    for event in rest:
        if event.arrival_s > gap_end_s:
            break
        if event.imu:
            _feed(fusion, event)
    odom = fusion.odom_at(gap_end_s)
    assert odom
    assert np.linalg.norm(odom.odom_from_body.translation_m - MOTION.position(gap_end_s)) < 0.06


def test_a_source_that_rejoins_does_not_move_odometry() -> None:
    fusion, rng = FusionFilter(), np.random.default_rng(1)
    for n in range(801):
        fusion.add_imu([_hovering(n / 200, rng)])
        if n % 20 == 0 and n <= 400:
            fusion.add_pose(StampedPose(n / 200, Pose.from_yaw(0.0, rng.normal(0.0, 0.002, 3)), np.zeros(3)), n / 200)
    before = fusion.odom_at(2.0)
    assert before is not None
    elsewhere = Pose.from_yaw(1.0, np.array([3.0, -2.0, 0.5]))
    odom = StampedPose(3.9, Pose.from_yaw(0.1, np.array([0.2, 0.0, 0.0])), np.array([0.1, 0.0, 0.0]))
    assert fusion.rejoin(StampedPose(3.9, elsewhere, np.zeros(3)), odom)
    after = fusion.odom_at(4.0)
    assert after is not None
    np.testing.assert_allclose(after.odom_from_body.translation_m, [0.21, 0.0, 0.0], atol=0.01)
    assert after.reset_counter == before.reset_counter
    assert after.correction.epoch == before.correction.epoch + 1
    found = after.correction.world_from_odom @ odom.odom_from_body
    np.testing.assert_allclose(found.translation_m, elsewhere.translation_m, atol=1e-9)
    fusion.add_imu([_hovering(4.01, rng)])
    assert fusion.add_pose(StampedPose(4.0, elsewhere @ Pose.from_yaw(0.0, np.array([0.01, 0.0, 0.0])), np.zeros(3)), 4.01)


@pytest.mark.parametrize("offset_m", [0.0, 3.0])
@pytest.mark.parametrize(("imu_hz", "silent_s"), [(200, 12.0), (200, 25.0), (400, 5.0), (400, 60.0), (1000, 5.0)])
def test_a_source_that_was_silent_longer_than_the_track_is_kept_is_accepted_again(
    imu_hz: int, silent_s: float, offset_m: float
) -> None:
    fusion, returns_s, counters, rng = FusionFilter(), 5.0 + silent_s, [], np.random.default_rng(1)
    for n in range(int((returns_s + 2.0) * imu_hz)):
        t = n / imu_hz
        fusion.add_imu([_hovering(t, rng)])
        if n % (imu_hz // 20) == 0 and not 5.0 <= t < returns_s:
            place_m = np.array([offset_m * (t > 5.0), 0.0, 1.0]) + rng.normal(0.0, 0.002, 3)
            fusion.add_pose(StampedPose(t, Pose.from_yaw(0.0, place_m), np.zeros(3)), t)
            odom = fusion.odom_at(t)
            if returns_s <= t < returns_s + 0.9:
                assert odom is None or odom.quality == 0  # on trial
            elif odom is not None:
                counters.append(odom.reset_counter)
    odom = fusion.odom_at(returns_s + 2.0)
    assert odom is not None
    assert (odom.health, odom.quality) == (PoseHealth.GOOD, 100)
    assert odom.odom_from_body.translation_m == pytest.approx([offset_m, 0.0, 1.0], abs=0.02)
    if offset_m:
        assert set(counters) == {0, 1}  # odom restarted, and its reset counter shows it
    assert set(counters) <= {0, 1}


def test_a_track_that_no_longer_reaches_the_poses_kept_is_no_accident() -> None:
    fusion, end_s, rng = FusionFilter(), 4.0, np.random.default_rng(1)
    for n in range(int(end_s * 20)):
        fusion.add_imu([_hovering(n / 20, rng)])
        fusion.add_pose(_pose_at(n / 20), n / 20)
    fusion.add_imu([_hovering(end_s - 0.05 + 1e-6 * (n + 1), rng) for n in range(5000)])  # a burst
    assert not fusion.add_pose(_pose_at(end_s - 0.52), end_s)  # late: between two poses, before anything that the track knows
    assert [fusion.add_pose(_pose_at(end_s + n / 20), end_s + n / 20) for n in range(40)][-1]


def _hovering(stamp_s: float, rng: np.random.Generator) -> ImuSample:
    return ImuSample(stamp_s, rng.normal(0.0, 0.002, 3), np.array([0.0, 0.0, GRAVITY_MPS2]) + rng.normal(0.0, 0.02, 3))


def _pose_at(stamp_s: float) -> StampedPose:
    return StampedPose(stamp_s, Pose.from_yaw(0.0, np.array([0.0, 0.0, 1.0])), np.zeros(3))


def test_scattered_poses_are_never_taken_back() -> None:
    """Nonsense that does not even agree with itself stays out, however long it lasts."""
    fusion, rest = _warm()
    rng = np.random.default_rng(2)
    for event in rest:
        if event.pose:
            scattered = event.pose.odom_from_body.translation_m + rng.choice([-3.0, 3.0], 3) * rng.uniform(1.0, 5.0, 3)
            event.pose = replace(event.pose, odom_from_body=Pose(event.pose.odom_from_body.quat_wxyz, scattered))
        assert _feed(fusion, event) == (event.imu is not None)
    assert fusion.newest_pose_s < NOW_S < rest[-1].arrival_s - 3.0


def test_a_dead_imu_leaves_a_working_filter() -> None:
    fusion, rest = _warm()
    for event in rest:
        if event.pose:
            assert _feed(fusion, event)
    end_s = fusion.newest_pose_s + 0.1
    odom = fusion.odom_at(end_s)
    assert odom
    assert odom.quality == 60
    assert np.linalg.norm(odom.odom_from_body.translation_m - MOTION.position(end_s)) < 0.08


def test_before_the_first_pose_there_is_no_odometry() -> None:
    fusion = FusionFilter()
    assert fusion.odom_at(1.0) is None
    fusion.add_imu([ImuSample(1.0, np.zeros(3), np.array([0.0, 0.0, 9.8]))])
    assert fusion.odom_at(1.0) is None


def test_it_is_cheap() -> None:
    """On the reference machine, quietest of five flights: 0.5 ms a pose, 0.1 ms a sample (measured 0.3 and 0.015)."""
    slower = measure_machine_speed().cpu_slowdown
    imu_s, pose_s = (min(costs_s) / slower for costs_s in zip(*(_median_costs_s() for _ in range(5)), strict=True))
    assert imu_s < 1e-4
    assert pose_s < 5e-4 * 1.5  # caches shared with other work


def _median_costs_s() -> tuple[float, float]:
    """Return the median time for an inertial sample, and for a pose."""
    costs: dict[str, list[float]] = {"imu": [], "pose": []}
    fusion = FusionFilter()
    for event in events(MOTION, 3.0, 0):
        start_s = time.thread_time()
        _feed(fusion, event)
        costs["imu" if event.imu else "pose"].append(time.thread_time() - start_s)
    return float(np.median(costs["imu"])), float(np.median(costs["pose"]))
