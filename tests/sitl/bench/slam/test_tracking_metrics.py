from __future__ import annotations

import numpy as np
import pytest
from sequence_of_noise import sequence_of_noise

from sitl.apps.sequence_faults import FaultWindow
from sitl.bench.slam.tracking_metrics import figures_of
from sitl.bench.slam.tracking_run import SequenceFrames, TrackingRun, run
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, StampedPose

SEQUENCE = sequence_of_noise()
STAMP_S = SEQUENCE.stamp_s
WINDOW = FaultWindow(float(STAMP_S[120]), float(STAMP_S[135]))


def answers(age_s: FloatArray | float = 0.0) -> TrackingRun:
    """Return the run of a perfect tracker, whose poses are age_s (N,) older than the frames."""
    count = len(STAMP_S)
    poses = SEQUENCE.true_body_at(STAMP_S - age_s)
    claimed = np.broadcast_to(np.diag([0.02**2, 0.02**2, 0.01**2]), (count, 3, 3)).copy()
    return TrackingRun(
        STAMP_S, np.full(count, 80), np.ones(count, np.bool_), STAMP_S - age_s, poses, claimed, np.linspace(1e-3, 11e-3, count)
    )


def test_errors_are_compared_with_what_the_tracker_claims() -> None:
    assert figures_of(answers(), SEQUENCE, []).within_claimed == 1.0
    off, random = answers(), np.random.default_rng(3)
    off.odom_from_body[1:, :3, 3] += random.normal(0.0, (0.02, 0.02, 0.01), (len(STAMP_S) - 1, 3))
    share = figures_of(off, SEQUENCE, []).within_claimed
    assert share == pytest.approx(0.95, abs=0.03)
    off.place_covariance[:] /= 4.0  # sigma is claimed to be half of what it is: 58 % of a chi-square with 3 degrees of freedom
    share = figures_of(off, SEQUENCE, []).within_claimed
    assert share == pytest.approx(0.42, abs=0.07)


def test_a_world_that_is_turned_is_no_error_and_one_that_tilts_is() -> None:
    one = answers()
    turned = Pose.from_yaw(1.0, np.array([3.0, -2.0, 1.0])).matrix()
    one.odom_from_body[:] = turned @ one.odom_from_body
    assert figures_of(one, SEQUENCE, []).within_claimed == 1.0
    tilted = Pose.from_rotation_vector(np.array([0.05, 0.0, 0.0]), np.zeros(3)).matrix()
    one.odom_from_body[:] = tilted @ one.odom_from_body
    share = figures_of(one, SEQUENCE, []).within_claimed
    assert share is not None
    assert share < 0.6


def test_a_perfect_tracker_has_no_error() -> None:
    found = figures_of(answers(), SEQUENCE, [])
    assert found.error is not None
    assert found.error.ate_max_m < 1e-6
    assert found.error.length_m == pytest.approx(0.6 * (STAMP_S[-1] - STAMP_S[0]), rel=1e-3)
    assert (found.lost, found.false_good, found.first_pose_s, found.reactions) == (0.0, 0.0, 0.0, ())
    assert found.median_ms == pytest.approx(6.0)
    assert found.p95_ms == pytest.approx(10.5)


def test_a_pose_is_compared_with_the_truth_at_its_own_stamp() -> None:
    age_s: FloatArray = np.where(np.arange(len(STAMP_S)) % 2, 0.04, 0.0)
    older = figures_of(answers(age_s), SEQUENCE, []).error
    assert older is not None
    assert older.ate_m < 1e-4
    wrong_stamp = answers(age_s)
    wrong_stamp.pose_stamp_s[:] = STAMP_S
    late = figures_of(wrong_stamp, SEQUENCE, []).error
    assert late is not None
    assert late.ate_m == pytest.approx(0.5 * 0.6 * 0.04, rel=0.02)


def test_lost_frames_are_counted_from_the_first_pose_on() -> None:
    one = answers()
    one.answered[:30] = False
    one.quality[150:177] = 0
    found = figures_of(one, SEQUENCE, [])
    assert found.first_pose_s == pytest.approx(2.0)
    assert found.lost == pytest.approx(27 / 270)
    assert found.error is not None
    assert found.error.ate_max_m < 1e-6, "lost poses are not judged"


def test_a_good_pose_far_off_is_false_good() -> None:
    one = answers()
    one.odom_from_body[250:, 0, 3] += 3.0
    found = figures_of(one, SEQUENCE, [WINDOW])
    assert found.false_good == pytest.approx(50 / 300)
    assert found.reactions[0].false_good_s == pytest.approx(49 / 15.0)
    one.quality[250:] = 0
    assert figures_of(one, SEQUENCE, [WINDOW]).false_good == 0.0


def test_the_reaction_to_a_window_is_timed_on_the_stamps() -> None:
    one = answers()
    one.quality[123:141] = 0  # reported after 3 frames, back 6 frames after the end
    (reaction,) = figures_of(one, SEQUENCE, [WINDOW]).reactions
    assert reaction.begin_s == pytest.approx(8.0)
    assert reaction.reported_s == pytest.approx(3 / 15.0)
    assert reaction.back_s == pytest.approx(6 / 15.0)
    assert reaction.false_good_s == 0.0


def test_an_unreported_window_and_one_without_return_have_no_times() -> None:
    later = FaultWindow(float(STAMP_S[220]), float(STAMP_S[235]))
    one = answers()
    one.quality[225:] = 0
    never, gone = figures_of(one, SEQUENCE, [WINDOW, later]).reactions
    assert (never.reported_s, never.back_s) == (None, 0.0)
    assert gone.reported_s == pytest.approx(5 / 15.0)
    assert gone.back_s is None


def test_back_with_a_gross_error_is_not_back() -> None:
    one = answers()
    one.quality[120:135] = 0
    one.odom_from_body[135:150, 1, 3] += 0.5
    (reaction,) = figures_of(one, SEQUENCE, [WINDOW]).reactions
    assert reaction.back_s == pytest.approx(15 / 15.0)
    assert reaction.false_good_s == pytest.approx(1.0)


def test_poses_in_a_window_do_not_count_as_error_or_lost() -> None:
    one = answers()
    one.odom_from_body[120:135, 0, 3] += 5.0
    found = figures_of(one, SEQUENCE, [WINDOW])
    assert found.error is not None
    assert found.error.ate_max_m < 1e-6
    assert found.lost == 0.0
    assert found.reactions[0].false_good_s == pytest.approx(1.0)


def test_a_tracker_that_never_answers_has_no_error() -> None:
    one = answers()
    one.answered[:] = False
    found = figures_of(one, SEQUENCE, [WINDOW])
    assert (found.error, found.lost, found.first_pose_s, found.false_good) == (None, 1.0, None, 0.0)
    assert found.reactions[0].reported_s == 0.0


class Listener:
    """Tracker that records what it gets."""

    def __init__(self) -> None:
        self.imu_s: list[float] = []
        self.known_s: list[float] = []
        self.frames: list[Frame] = []

    def add_imu(self, samples: list[ImuSample]) -> None:
        self.imu_s += [sample.stamp_s for sample in samples]

    def track(self, frame: Frame, body_from_depth: Pose) -> StampedPose | None:
        self.frames.append(frame)
        self.known_s.append(self.imu_s[-1])
        if frame.sequence % 2:
            return None
        return StampedPose(frame.stamp_s - 0.01, body_from_depth, np.zeros(3), quality=7)


def test_a_frame_comes_with_the_samples_that_arrived_before_it() -> None:
    from dataclasses import replace

    imu = np.zeros((4000, 7))
    imu[:, 0] = 9.9 + np.arange(4000) / 200.0
    fed = replace(SEQUENCE, imu=imu)
    listener = Listener()
    done = run(listener, fed)
    assert listener.imu_s == sorted(set(listener.imu_s))
    for frame, arrival_s, known_s in zip(listener.frames, fed.arrival_s, listener.known_s, strict=True):
        assert known_s <= arrival_s < known_s + 0.0051 or known_s == imu[-1, 0], frame.stamp_s
    assert done.answered.tolist() == [n % 2 == 0 for n in range(300)]
    assert (done.quality[::2] == 7).all()
    assert done.pose_stamp_s[::2] == pytest.approx(STAMP_S[::2] - 0.01)
    assert done.odom_from_body[0] == pytest.approx(SEQUENCE.body_from_depth[0])
    assert not done.good[1::2].any()


def test_frames_are_those_of_the_product_camera() -> None:
    from dataclasses import replace

    depth_mm = SEQUENCE.depth_mm.copy()
    depth_mm[0, 0, :5] = [0, 299, 300, 6000, 6001]
    frame = SequenceFrames(replace(SEQUENCE, depth_mm=depth_mm))[0]
    assert np.isnan(frame.depth_m[0, [0, 1, 4]]).all()
    assert frame.depth_m[0, 2:4].tolist() == pytest.approx([0.3, 6.0])
    assert (frame.depth_intrinsics.width, frame.rgb_intrinsics.width) == (212, 212)
    assert frame.rgb_from_depth.translation_m.tolist() == [0.015, 0.0, 0.0]
