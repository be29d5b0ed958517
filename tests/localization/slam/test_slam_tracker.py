"""The tracker on a rendered flight: accuracy, and what a camera that is covered, frozen or wrong does to it."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Container, Iterator
from dataclasses import replace

import numpy as np
import pytest
from slam_flight import (
    BODY_FROM_DEPTH,
    FORCE_NOISE_MPS2,
    GYRO_BIAS_RADPS,
    GYRO_NOISE_RADPS,
    RATE_HZ,
    REST_S,
    SECONDS,
    Tracked,
    ate_m,
    colourless,
    covered,
    fly,
    frame,
    frames,
    imu,
    rendered,
    truth,
)

from uav_recon.localization.slam.keyframe_map import no_keyframes
from uav_recon.localization.slam.rgbd_registration import Registration
from uav_recon.localization.slam.slam_tracker import SlamTracker
from uav_recon.localization.slam.tracking_monitor import TrackingFault
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, PoseHealth

FAULT_S = 1.0  # a covered lens, frozen frames, a false wall
REPORTED_S = 0.3


def _during(begin_s: float, wrong: Callable[[Frame], Frame]) -> Callable[[Frame], Frame]:
    return lambda true: wrong(true) if begin_s <= true.stamp_s < begin_s + FAULT_S else true


def _poses(answers: list[Tracked], from_s: float, to_s: float = np.inf) -> list[Tracked]:
    return [answer for answer in answers if answer.pose is not None and from_s <= answer.stamp_s < to_s]


def _worst_m(answers: list[Tracked]) -> float:
    return max(answer.error_m for answer in answers if answer.error_m is not None)


@functools.cache
def _whole_flight() -> tuple[SlamTracker, list[Tracked]]:
    tracker = SlamTracker()
    return tracker, fly(tracker, frames(SECONDS))


def test_a_flight_through_a_textured_room() -> None:
    tracker, answers = _whole_flight()
    assert len(_poses(answers, 0.2)) == len(answers) - round(0.2 * RATE_HZ)  # from the rest on, one for each frame
    assert ate_m(answers) < 0.03
    assert _worst_m(answers) < 0.06
    assert all(answer.error_rad < 0.03 for answer in answers if answer.error_rad is not None)
    assert all(answer.fault is None for answer in answers)
    np.testing.assert_allclose(tracker.gyro.bias_radps, [0.006, -0.004, 0.005], atol=0.001)
    assert tracker.delay_s == pytest.approx(0.0, abs=0.012)
    velocity = np.gradient([truth(answer.stamp_s).translation_m for answer in answers], 1.0 / RATE_HZ, axis=0)
    off = [
        np.linalg.norm(answer.pose.velocity_odom_mps - true)
        for answer, true in zip(answers, velocity, strict=True)
        if answer.pose
    ]
    assert np.median(off) < 0.05


def test_two_trackers_give_the_same_poses() -> None:
    seconds = 4.0
    again = fly(SlamTracker(), frames(seconds))
    for first, second in zip(_whole_flight()[1], again, strict=False):
        assert (first.pose is None) == (second.pose is None)
        if first.pose is not None and second.pose is not None:
            assert first.pose.stamp_s == second.pose.stamp_s
            np.testing.assert_array_equal(first.pose.odom_from_body.matrix(), second.pose.odom_from_body.matrix())
            np.testing.assert_array_equal(first.pose.covariance, second.pose.covariance)


def test_the_age_of_the_frames_is_found_and_taken_from_the_stamps() -> None:
    tracker = SlamTracker()
    answers = fly(tracker, frames(6.0, delay_s=0.03))
    assert tracker.delay_s == pytest.approx(0.03, abs=0.015)
    assert ate_m(answers) < 0.03  # at the instants that the poses claim
    last = answers[-1].pose
    assert last is not None
    assert last.stamp_s == answers[-1].stamp_s - tracker.delay_s


@pytest.mark.parametrize("begin_s", [3.0, 6.0])
def test_a_covered_camera_gives_no_pose_and_the_track_comes_back(begin_s: float) -> None:
    answers = fly(SlamTracker(), frames(begin_s + FAULT_S + 2.5, _during(begin_s, covered)))
    assert not _poses(answers, begin_s, begin_s + FAULT_S)
    back = _poses(answers, begin_s + FAULT_S)
    assert back[0].stamp_s < begin_s + FAULT_S + 2.0
    assert _worst_m(back) < 0.1
    assert answers[-1].fault is None


def test_a_camera_without_colour_that_was_covered_never_gives_a_wrong_pose() -> None:
    """Depth alone does not show the place along a wall: after the cover it takes corners of the room to know it again."""
    cover = _during(5.0, covered)
    answers = fly(SlamTracker(), frames(9.0, lambda true: colourless(cover(true))))
    assert not _poses(answers, 5.0, 6.0)
    assert _worst_m(_poses(answers, 0.0)) < 0.3


def test_a_frozen_camera_is_reported_after_a_third_of_a_second() -> None:
    """The camera repeats an image with new stamps."""
    begin_s, still = 3.0, frame(round(3.0 * RATE_HZ))
    answers = fly(SlamTracker(), frames(5.0, _during(begin_s, lambda true: replace(still, stamp_s=true.stamp_s))))
    stuck = [answer for answer in answers if begin_s < answer.stamp_s < begin_s + FAULT_S]
    assert {answer.fault for answer in stuck if answer.stamp_s <= begin_s + 0.301} == {TrackingFault.REPEAT}
    assert {answer.fault for answer in stuck if answer.stamp_s > begin_s + 0.301} == {TrackingFault.FROZEN}
    assert not _poses(answers, begin_s + 0.01, begin_s + FAULT_S)
    assert _worst_m(_poses(answers, begin_s + FAULT_S)) < 0.06


def _repeated(numbers: Container[int]) -> Callable[[Frame], Frame]:
    """The images of the newest frame that has none of these numbers."""

    def seen(true: Frame) -> Frame:
        shown = true
        while shown.sequence in numbers:
            shown = frame(shown.sequence - 1)
        return replace(true, depth_m=shown.depth_m, rgb=shown.rgb)

    return seen


def test_a_frame_that_repeats_is_no_frame() -> None:
    """As in a recording in which 91 of 1,000 frames repeat: the next one is accepted at once, with the landmarks."""
    seconds, numbers = 6.0, set(range(45, 90, 11)) | {60, 61}
    tracker = SlamTracker()
    answers = fly(tracker, frames(seconds, _repeated(numbers)))
    assert {n for n, answer in enumerate(answers) if answer.fault is TrackingFault.REPEAT} == numbers
    assert all(answer.fault in (None, TrackingFault.REPEAT) for answer in answers)
    assert {n for n, answer in enumerate(answers) if answer.pose is None and n >= 0.2 * RATE_HZ} == numbers
    assert _worst_m(_poses(answers, 0.0)) < 0.06


def _without_returns(share: float) -> Callable[[Frame], Frame]:
    """Returns in this share of the pixels; colour as it is."""

    def seen(true: Frame) -> Frame:
        kept = np.random.default_rng(true.sequence).random(true.depth_m.shape) < share
        return replace(true, depth_m=np.where(kept, true.depth_m, np.nan).astype(np.float32))

    return seen


@pytest.mark.parametrize("spoil", [_without_returns(0.0), _without_returns(0.05), covered], ids=["empty", "sparse", "covered"])
@pytest.mark.parametrize("every", [3, 5])
def test_a_frame_that_shows_nothing_costs_itself_alone(spoil: Callable[[Frame], Frame], every: int) -> None:
    begin = round(3.0 * RATE_HZ)

    def bad(n: int) -> bool:
        return n >= begin and n % every == 0

    tracker = SlamTracker()
    answers = fly(tracker, frames(7.0, lambda true: spoil(true) if bad(true.sequence) else true))
    assert all((answer.pose is None) == bad(n) for n, answer in enumerate(answers) if n >= 0.2 * RATE_HZ)
    assert {answer.fault for n, answer in enumerate(answers) if bad(n)} == {TrackingFault.FEW_POINTS}
    assert _worst_m(_poses(answers, 3.0)) < 0.06
    whole = SlamTracker()
    fly(whole, frames(7.0))
    assert tracker.surfaces.count >= 0.9 * whole.surfaces.count, "the map grows on between them"


def test_after_a_brief_gap_a_frame_that_shows_much_that_is_new_is_accepted() -> None:
    """As at the lift-off: what comes into view is not known yet, and it proves nothing."""
    gap = round(REST_S * RATE_HZ) + 3

    def seen(true: Frame) -> Frame:
        if true.sequence == gap:
            return covered(true)
        shown = np.where(np.arange(true.depth_m.shape[1]) < 70, true.depth_m, np.nan)
        return colourless(replace(true, depth_m=shown.astype(np.float32)) if true.sequence < gap else true)

    answers = fly(SlamTracker(), frames(3.0, seen))
    assert [answer.pose is None for answer in answers[gap - 1 : gap + 4]] == [False, True, False, False, False]
    assert _worst_m(_poses(answers, 0.2)) < 0.06


def _with_one_wrong(colour: bool) -> tuple[int, list[Tracked]]:
    wrong = round(3.0 * RATE_HZ)

    def seen(true: Frame) -> Frame:
        shown = _wall(1.0, 0.8)(true) if true.sequence == wrong else true
        return colourless(shown) if true.sequence == wrong and not colour else shown

    return wrong, fly(SlamTracker(), frames(4.0, seen))


def test_a_wrong_frame_is_followed_by_a_proof() -> None:
    """A false wall may have moved the track: poses are given again from the second frame on."""
    wrong, answers = _with_one_wrong(colour=False)
    assert [answer.pose is None for answer in answers[wrong - 1 : wrong + 4]] == [False, True, True, False, False]


def test_landmarks_show_the_pose_of_a_frame_with_wrong_depth() -> None:
    wrong, answers = _with_one_wrong(colour=True)
    assert answers[wrong].fault is TrackingFault.DEPTH
    assert not any(answer.pose is None for answer in answers[wrong - 1 : wrong + 4])
    assert _worst_m(answers[wrong : wrong + 4]) < 0.06


@pytest.mark.parametrize("off_m", [(0.09, 0.0, 0.0), (0.0, 0.09, 0.0), (0.0, 0.0, 0.07), (-0.06, -0.06, 0.0)])
def test_a_wrong_frame_that_was_accepted_after_a_gap_is_left_out_at_the_next_frame(off_m: tuple[float, float, float]) -> None:
    """The frame shows the view from another place, within what the gap allows."""
    wrong = round(5.0 * RATE_HZ)
    true = truth(wrong / RATE_HZ)
    depth, rgb = rendered(Pose(true.quat_wxyz, true.translation_m + np.array(off_m)) @ BODY_FROM_DEPTH, 1)
    seen = [replace(each, depth_m=depth, rgb=rgb) if each.sequence == wrong else each for each in frames(5.6)]
    answers = fly(SlamTracker(), [each for each in seen if not wrong - 5 <= each.sequence < wrong])
    accepted, after = answers[wrong - 5], answers[wrong - 4 :]
    assert accepted.error_m == pytest.approx(math.hypot(*off_m), abs=0.01)
    assert all(answer.fault is None for answer in after)
    assert _worst_m(after) < 0.02


def _wall(share: float, away_m: float) -> Callable[[Frame], Frame]:
    """A wall in the middle of the image that is not there."""

    def seen(true: Frame) -> Frame:
        depth, (height, width) = true.depth_m.copy(), true.depth_m.shape
        v, u = round(height * (1.0 - share) / 2), round(width * (1.0 - share) / 2)
        noise = np.random.default_rng(true.sequence).standard_normal((height - 2 * v, width - 2 * u))
        depth[v : height - v, u : width - u] = away_m + 0.004 * away_m**2 * noise
        return replace(true, depth_m=depth)

    return seen


@pytest.mark.parametrize(("share", "begin_s"), [(1.0, 3.0), (0.8, 12.0)])
def test_a_wall_that_is_not_there_is_reported_and_moves_nothing(share: float, begin_s: float) -> None:
    answers = fly(SlamTracker(), frames(begin_s + 2.0, _during(begin_s, _wall(share, 0.8))))
    wrong = [answer for answer in answers if begin_s <= answer.stamp_s < begin_s + REPORTED_S]
    assert any(answer.fault in (TrackingFault.FIT, TrackingFault.DEPTH) for answer in wrong)
    assert _worst_m(_poses(answers, begin_s)) < 0.3
    back = _poses(answers, begin_s + FAULT_S)
    assert len(back) > 0.8 * RATE_HZ
    assert _worst_m(back) < 0.06


def test_a_patch_of_wrong_depth_does_not_move_the_pose() -> None:
    """Landmarks and the rest of the depth image carry the pose."""
    answers = fly(SlamTracker(), frames(5.0, _during(3.0, _wall(0.4, 1.0))))
    assert len(_poses(answers, 3.0)) >= 0.9 * 2.0 * RATE_HZ
    assert _worst_m(_poses(answers, 3.0)) < 0.06


@pytest.mark.parametrize(("factor", "shift_mps2"), [(0.5, 0.0), (1.0, 2.0)])
def test_an_accelerometer_that_lies_in_flight_moves_nothing(factor: float, shift_mps2: float) -> None:
    def wrong(sample: ImuSample) -> ImuSample:
        force = factor * sample.specific_force_mps2 + np.array([shift_mps2, 0.0, 0.0])
        return replace(sample, specific_force_mps2=force if sample.stamp_s > 3.0 else sample.specific_force_mps2)

    answers = fly(SlamTracker(), frames(8.0), samples=tuple(wrong(sample) for sample in imu()))
    assert len(_poses(answers, 3.0)) >= 0.9 * 5.0 * RATE_HZ
    assert _worst_m(_poses(answers, 3.0)) < 0.1


def test_without_inertial_samples_the_images_carry_the_pose() -> None:
    answers = fly(SlamTracker(), frames(8.0), samples=())
    poses = _poses(answers, 0.0)
    assert poses[0].stamp_s == pytest.approx(0.25, abs=0.1)  # the body is taken as level after this time
    assert len(_poses(answers, 0.4)) > 0.95 * (8.0 - 0.4) * RATE_HZ
    assert _worst_m(poses) < 0.15


def test_an_inertial_sensor_that_starts_after_the_camera_still_levels_the_body() -> None:
    """Its first samples come 0.5 s after the first frame, at rest: the start without them is forgotten."""
    tracker = SlamTracker()
    late = tuple(sample for sample in imu() if sample.stamp_s > 0.5)
    answers = fly(tracker, frames(4.0), samples=late)
    np.testing.assert_allclose(tracker.gyro.bias_radps, GYRO_BIAS_RADPS, atol=0.002)
    assert _poses(answers, 0.0)[0].stamp_s == pytest.approx(0.25, abs=0.1)
    assert _worst_m(_poses(answers, 1.1)) < 0.06


def test_the_frame_at_which_the_body_is_levelled_again_is_in_the_new_map() -> None:
    tracker, late = SlamTracker(), tuple(sample for sample in imu() if sample.stamp_s > 0.5)
    blocks, maps = list[int](), list[object]()

    def seen() -> Iterator[Frame]:
        for each in frames(REST_S):
            yield each
            blocks.append(tracker.surfaces.count)
            maps.append(tracker.surfaces)

    fly(tracker, seen(), late)
    again = next(n for n in range(len(maps) - 1, 0, -1) if maps[n] is not maps[n - 1])
    assert blocks[again - 1] > 0, "it had begun without inertial samples"
    assert blocks[again] > 0


def test_without_colour_depth_carries_the_pose_as_far_as_it_determines_it() -> None:
    answers = fly(SlamTracker(), frames(8.0, colourless))
    poses = _poses(answers, 0.2)
    assert len(poses) > 60
    sure = [each for each in poses if each.pose is not None and each.pose.health is PoseHealth.GOOD]
    assert len(sure) > 60
    assert _worst_m(sure) < 0.03
    for each in poses:
        assert each.pose is not None
        assert each.error_m is not None
        assert each.error_m < 3.0 * math.sqrt(each.pose.covariance[0, 0])


def _shaking(sample: ImuSample) -> ImuSample:
    return ImuSample(sample.stamp_s, sample.gyro_radps + np.array([0.3, 0.0, 0.0]), sample.specific_force_mps2)


def test_it_starts_only_at_rest() -> None:
    tracker = SlamTracker()
    samples = [sample for sample in imu() if sample.stamp_s < 1.0]
    tracker.add_imu([_shaking(sample) for sample in samples])
    for n in range(10):
        assert tracker.track(replace(frame(n), stamp_s=0.9 + 0.01 * n), BODY_FROM_DEPTH) is None
    assert tracker.surfaces.count == 0
    rest = [replace(sample, stamp_s=sample.stamp_s + 1.4) for sample in samples if sample.stamp_s < REST_S]
    tracker.add_imu(rest)
    pose = tracker.track(replace(frame(10), stamp_s=2.35), BODY_FROM_DEPTH)
    assert pose is not None
    np.testing.assert_allclose(pose.odom_from_body.translation_m, np.zeros(3))
    np.testing.assert_allclose(pose.odom_from_body.rotation(), np.eye(3), atol=0.03)
    assert pose.odom_from_body.yaw_rad() == pytest.approx(0.0, abs=1e-9)


def test_a_body_on_the_pad_stays_exactly_where_it_is() -> None:
    answers = fly(SlamTracker(), frames(REST_S))
    places = [answer.pose.odom_from_body.matrix() for answer in answers if answer.pose is not None]
    assert len(places) > 10
    assert all(np.array_equal(place, places[0]) for place in places)


def test_a_frame_without_landmarks_and_depth_at_the_start_is_no_error() -> None:
    tracker = SlamTracker()
    answers = fly(tracker, frames(0.8, covered))
    assert all(answer.fault is None for answer in answers)
    assert tracker.surfaces.count == 0


def _found(track_m: float, against_track_m: float) -> Registration:
    """Return a registration. track_m: standard deviation of the track, in one direction."""
    covariance, against = np.diag([1e-6] * 5 + [track_m**2 + against_track_m**2]), np.diag([1e-6, 1e-6, against_track_m**2])
    return Registration(
        Pose.identity(), no_keyframes(), covariance, np.zeros(6), np.eye(6), against, np.eye(3), 900, 900, 900,
        np.array([90]), np.zeros(2), np.eye(2), 0.01, 1e5,
    )  # fmt: skip


def test_doubt_about_the_place_is_reported_before_there_is_no_pose() -> None:
    """Each step: seconds since the place was sure, sigma of the track and against it, and what is reported."""
    tracker = SlamTracker()
    fly(tracker, frames(0.8))
    steps = [
        (0.0, 0.04, 0.01, PoseHealth.GOOD),
        (0.1, 0.04, 0.041, PoseHealth.DEGRADED),  # blind for a while
        (0.2, 0.04, 0.035, PoseHealth.DEGRADED),
        (0.3, 0.04, 0.033, PoseHealth.GOOD),
        (0.4, 0.081, 0.001, PoseHealth.DEGRADED),
        (3.2, 0.34, 0.001, PoseHealth.DEGRADED),  # on the way back
        (3.25, 0.351, 0.001, None),
        (3.5, 0.121, 0.001, None),
        (3.6, 0.119, 0.001, PoseHealth.DEGRADED),
        (3.7, 0.067, 0.001, PoseHealth.GOOD),
    ]
    for after_s, track_m, against_m, health in steps:
        pose = tracker._pose(10.0 + after_s, _found(track_m, against_m))
        assert (None if pose is None else pose.health) == health, after_s
        if pose is not None:
            assert math.sqrt(pose.covariance[0, 0]) >= math.hypot(track_m, against_m)
            assert (pose.health_reason is None) == (health is PoseHealth.GOOD)
            assert pose.quality <= 100 * min(0.08 / track_m, 1.0) + 0.5


def test_an_uncertainty_that_grows_with_the_flight_is_no_doubt() -> None:
    """A way back would not reduce it. The covariance tells it."""
    tracker = SlamTracker()
    fly(tracker, frames(0.8))
    poses = [tracker._pose(10.0 + second, _found(0.03 + 0.002 * second, 0.005)) for second in range(40)]
    poses.append(tracker._pose(49.1, _found(0.15, 0.005)))  # a bare wall
    given = [pose for pose in poses if pose is not None]
    assert [pose.health for pose in given] == [PoseHealth.GOOD] * 40 + [PoseHealth.DEGRADED]
    assert math.sqrt(given[39].covariance[0, 0]) > 0.1


def test_a_found_error_enters_the_poses_slowly() -> None:
    """The autopilot lands a vehicle whose poses move by 0.2 m/s without its inertial sensors."""
    tracker = SlamTracker()
    fly(tracker, frames(0.8))
    shown_m = []
    for n in range(20):
        tracker._doubt.found(np.array([0.12 if n == 0 else 0.0, 0.0, 0.0]), 0.1)
        shown_m.append(0.12 + float(tracker._stamped(10.0 + 0.1 * n).odom_from_body.translation_m[0]))
    speed_mps = np.diff(shown_m) / 0.1
    assert 0.08 < speed_mps.max() < 0.15
    assert shown_m[-1] == pytest.approx(0.12)


def test_poses_that_still_contain_a_found_error_are_doubted() -> None:
    """Depth does not fit earlier views while an error of 12 cm is taken out of the poses at 0.1 m/s."""
    tracker, reported = SlamTracker(), list[PoseHealth]()
    fly(tracker, frames(0.8))
    tracker._doubt.found(np.array([0.12, 0.0, 0.0]), 0.1)
    for n in range(10):
        pose = tracker._pose(10.0 + 0.1 * n, _found(0.01, 0.005))
        assert pose is not None
        reported.append(pose.health)
        tracker._doubt.found(np.zeros(3), 0.1)
    assert reported == [PoseHealth.DEGRADED] * 6 + [PoseHealth.GOOD] * 4


def _spooled(seconds: float) -> tuple[ImuSample, ...]:
    """Return the samples of a flight whose motors run for this time before it lifts."""
    shaken, random = list[ImuSample](), np.random.default_rng(8)
    for sample in imu():
        if sample.stamp_s > REST_S and not shaken:
            still = np.array([each.specific_force_mps2 for each in imu() if each.stamp_s < REST_S]).mean(axis=0)
            for n in range(round(seconds * 200)):
                rate = GYRO_BIAS_RADPS + GYRO_NOISE_RADPS * random.standard_normal(3)
                shaken.append(ImuSample(REST_S + n / 200, rate, still + FORCE_NOISE_MPS2 * random.standard_normal(3)))
    before = [sample for sample in imu() if sample.stamp_s <= REST_S]
    return (*before, *shaken, *(replace(s, stamp_s=s.stamp_s + seconds) for s in imu() if s.stamp_s > REST_S))


def test_a_body_whose_motors_run_stands_where_it_stood_and_its_first_motion_is_known() -> None:
    """A view of nothing but a wall does not show that the body has not slid along it."""
    waits_s, tracker, seen = 2.0, SlamTracker(), list[Frame]()
    for n in range(round((REST_S + waits_s) * RATE_HZ)):
        depth_m, rgb = rendered(truth(0.0) @ BODY_FROM_DEPTH, 500 + n)
        seen.append(replace(frame(0), stamp_s=n / RATE_HZ, depth_m=depth_m, rgb=rgb))
    seen += [replace(frame(n), stamp_s=n / RATE_HZ + waits_s) for n in range(round(REST_S * RATE_HZ) + 1, round(3.5 * RATE_HZ))]
    errors_m, stood_m = list[float](), list[float]()
    for answer in fly(tracker, map(colourless, seen), _spooled(waits_s)):
        if answer.pose is not None:
            shown_s = answer.stamp_s if answer.stamp_s < REST_S else max(answer.stamp_s - waits_s, REST_S)
            off = truth(shown_s).inverse() @ answer.pose.odom_from_body
            (stood_m if answer.stamp_s < REST_S + waits_s else errors_m).append(float(np.linalg.norm(off.translation_m)))
            if len(errors_m) == 2:  # the first frame whose inertial samples or image show the motion
                true_mps = (truth(shown_s + 1e-3).translation_m - truth(shown_s - 1e-3).translation_m) / 2e-3
                assert answer.pose.velocity_odom_mps[0] == pytest.approx(true_mps[0], abs=0.03)
    assert max(stood_m) < 0.002
    assert max(errors_m) < 0.05


@pytest.mark.parametrize("unsure", [False, True])
def test_what_a_view_corrects_after_doubt_enters_the_poses_slowly(unsure: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """While the place is sure, the view corrects the prediction by millimetres in each frame, and the poses follow at once."""
    tracker, images, found_m = SlamTracker(), list(frames(2.0)), list[FloatArray]()
    fly(tracker, images[:-1])
    tracker._doubt.unsure = unsure
    monkeypatch.setattr(tracker._doubt, "found", lambda off_m, _: found_m.append(off_m))
    fly(tracker, images[-1:], tuple(sample for sample in imu() if sample.stamp_s > images[-2].stamp_s + 0.02))
    assert tracker._state is not None
    corrected_m = tracker._state.odom_from_body.translation_m - tracker._predicted.place_m
    assert np.array_equal(found_m[-1], corrected_m) is unsure
