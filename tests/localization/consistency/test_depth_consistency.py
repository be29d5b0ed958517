"""A room with a pillar and a table, seen from poses that are right, drift, or with pictures that are wrong."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from textured_room import ranges_m

from uav_recon.localization.calibration.calibration_filter import DELAY
from uav_recon.localization.consistency.depth_consistency import DepthConsistencyMonitor, _moved, _seen_through
from uav_recon.localization.consistency.past_view_comparison import CameraPose, ViewComparison
from uav_recon.types.camera import Frame, Intrinsics, body_from_camera
from uav_recon.types.camera_calibration import CameraMotion
from uav_recon.types.frames import Float32Array, FloatArray
from uav_recon.types.pose import Pose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

LENS = Intrinsics.from_fov(106, 60, 1.5, 1.0)
ROOM_M = np.array([[-3.0, -2.0, 0.0], [3.0, 2.5, 2.6]])
PILLARS_M = (np.array([[1.5, 0.7, 0.0], [2.0, 1.2, 2.6]]), np.array([[1.0, -1.6, 0.0], [2.5, -1.0, 0.9]]))
PERSON_M = np.array([[1.2, -0.25, 0.0], [1.6, 0.25, 2.0]])
BODY_FROM_DEPTH = body_from_camera(np.zeros(3), 0.26)
PERIOD_S = 1.0 / 6.0


def _depth(world_from_depth: Pose, *boxes_m: FloatArray) -> Float32Array:
    found: Float32Array = ranges_m(world_from_depth, LENS, ROOM_M, (*PILLARS_M, *boxes_m)).astype(np.float32)
    return found


def _body(n: int, turned_rad: float = 0.0) -> Pose:
    """A turn on the spot to and fro, with a little motion."""
    return Pose.from_yaw(0.5 * np.sin(0.1 * n) + turned_rad, np.array([0.3 * np.sin(0.07 * n), 0.2 * np.sin(0.05 * n), 1.2]))


class Flight:
    """Frames at 6 Hz with noise of depth and pose."""

    def __init__(self) -> None:
        self.monitor = DepthConsistencyMonitor()
        self.n = 0
        self._dice = np.random.default_rng(3)
        # rad a picture
        self.turning = 0.0
        self._turned_rad = 0.0

    def see(self, change: object = None, off_m: tuple[float, float, float] = (0.0, 0.0, 0.0), box: bool = False) -> bool:
        self._turned_rad += self.turning
        return self.see_from(_body(self.n, self._turned_rad), change, off_m, *([PERSON_M] if box else []))

    def see_from(self, body: Pose, change: object, off_m: tuple[float, float, float], *boxes_m: FloatArray) -> bool:
        here = body @ BODY_FROM_DEPTH
        depth_m = _depth(here, *boxes_m)
        depth_m += self._dice.standard_normal(depth_m.shape).astype(np.float32) * 0.004 * depth_m**2
        depth_m = change(depth_m) if callable(change) else depth_m
        reported = Pose(here.quat_wxyz, here.translation_m + off_m + self._dice.standard_normal(3) * 0.01)
        colour = np.zeros((2, 2, 3), np.uint8)
        frame = Frame(self.n * PERIOD_S, self.n, depth_m.astype(np.float32), LENS, colour, LENS, Pose.identity())
        self.n += 1
        return self.monitor.rejection(frame, CameraMotion.at_rest(reported)) is None

    @property
    def drift(self) -> Reason | None:
        return self.monitor.drift(self.n * PERIOD_S)


@pytest.fixture
def flight() -> Flight:
    made = Flight()
    assert all(made.see() for _ in range(120))
    assert made.drift is None
    return made


def _salted(depth_m: Float32Array) -> Float32Array:
    dice = np.random.default_rng(5)
    return np.where(dice.random(depth_m.shape) < 0.3, dice.uniform(0.3, 6.0, depth_m.shape), depth_m).astype(np.float32)


def _shifted(depth_m: Float32Array) -> Float32Array:
    return np.roll(depth_m, 16, axis=1)


def _nearly_empty(depth_m: Float32Array) -> Float32Array:
    """Returns in 10 % of the pixels, as of a lens that is dazzled or a stereo match that fails."""
    return np.where(np.random.default_rng(8).random(depth_m.shape) < 0.1, depth_m, np.nan).astype(np.float32)


def _empty(depth_m: Float32Array) -> Float32Array:
    return np.full_like(depth_m, np.nan)


def _farther(depth_m: Float32Array) -> Float32Array:
    return np.where(depth_m < 2.5, 2.0 * depth_m, depth_m).astype(np.float32)


def _bits(depth_m: Float32Array) -> Float32Array:
    dice, mm = np.random.default_rng(6), (depth_m * 1000).astype(np.int64)
    flipped = mm ^ (1 << dice.integers(0, 13, mm.shape))
    return (np.where(dice.random(mm.shape) < 0.33, flipped, mm) * 1e-3).astype(np.float32)


@pytest.mark.parametrize(
    "change", [_salted, _bits, lambda d: np.roll(d, 16, axis=1), lambda d: 0.5 * d, lambda d: 2.0 * d],
    ids=["salt", "bits", "shifted", "half", "twice"],
)  # fmt: skip
def test_a_wrong_picture_is_not_accepted_and_right_ones_are_again(flight: Flight, change: object) -> None:
    assert not any(flight.see(change) for _ in range(12))
    assert all(flight.see() for _ in range(12))


@pytest.mark.parametrize("pixels", [16, -16])
def test_a_picture_that_lies_aside_is_reported_at_once_whenever_it_begins(flight: Flight, pixels: int) -> None:
    """All round the room, also before walls that are looked at squarely, where less than a fifth of the points misfit."""
    flight.turning, reported = 0.16, 0
    for _ in range(40):
        reported += not copy.deepcopy(flight).see(lambda d: np.roll(d, pixels, axis=1))
        assert flight.see()
    assert reported >= 38


def test_after_a_wrong_picture_one_must_fit_and_not_only_follow(flight: Flight) -> None:
    """Shifted pictures of a camera that turned on followed the last right one by chance, once it stood before a wall."""
    assert copy.deepcopy(flight).see(box=True), "what comes into view is accepted"
    assert not flight.see(_shifted)
    assert not flight.see(box=True)
    assert flight.see()
    assert flight.see(box=True)


@pytest.mark.parametrize("turning", [0.0, 0.06, 0.16])
@pytest.mark.parametrize(
    ("change", "late"),
    [(_empty, 0), (_nearly_empty, 0), (_salted, 0), (_bits, 0), (_shifted, 2), (_farther, 2)],
    ids=["empty", "nearly-empty", "salt", "bits", "shifted", "farther"],
)
def test_one_wrong_frame_is_one_frame(flight: Flight, change: object, late: int, turning: float) -> None:
    """All round the room: what follows a wrong frame is accepted at once, after a doubt at the third frame."""
    flight.turning = turning
    for _ in range(40):
        after = copy.deepcopy(flight)
        accepted = after.see(change)
        assert not accepted or change is _farther or change is _shifted, "a wall seen squarely may look like that"
        assert [after.see() for _ in range(6)][late:] == [True] * (6 - late)
        assert flight.see()


def test_a_wrong_frame_that_was_accepted_raises_no_lasting_doubt(flight: Flight) -> None:
    """Before a plain wall a shifted image fits; the honest one after it does not fit that."""
    flight.turning, accepted, doubted = 0.16, 0, 0
    for _ in range(60):
        assert flight.see()
        after = copy.deepcopy(flight)
        if after.see(lambda depth_m: np.roll(depth_m, 10, axis=1)):
            accepted += 1
            later = [after.see() for _ in range(12)]
            doubted += not later[0]
            assert later[3:] == [True] * 9
    assert accepted >= 5
    assert doubted >= 1


def test_empty_frames_neither_begin_nor_prolong_a_doubt(flight: Flight) -> None:
    assert not any(flight.see(_empty) for _ in range(12))
    assert flight.see()
    still = Flight()
    assert all(still.see_from(ON_THE_PAD, _on_the_floor, (0.0, 0.0, 0.0)) for _ in range(30))
    assert not still.see_from(ON_THE_PAD, _half_as_far_again, (0.0, 0.0, 0.0))
    accepted = [still.see_from(ON_THE_PAD, _empty if n % 2 else _on_the_floor, (0.0, 0.0, 0.0)) for n in range(8)]
    assert accepted == [False] * 4 + [True, False] * 2


def test_a_camera_whose_first_frames_are_empty_is_accepted_afterwards() -> None:
    flight = Flight()
    assert not any(flight.see(_empty) for _ in range(12))
    assert all(flight.see() for _ in range(12))


ON_THE_PAD = Pose.from_yaw(np.pi, np.array([0.5, 0.25, 0.2]))  # what is in reach is floor


def _half_as_far_again(depth_m: Float32Array) -> Float32Array:
    return _on_the_floor(depth_m) * 1.5


def _on_the_floor(depth_m: Float32Array) -> Float32Array:
    return np.where(depth_m > 1.5, np.nan, depth_m).astype(np.float32)


def test_specks_of_noise_are_no_shift_where_the_picture_looks_the_same_aside() -> None:
    """As it was on the pad: two or three points of 130 had gone back and fitted aside, and nothing was accepted any more."""
    flight, dice = Flight(), np.random.default_rng(7)

    def specked(depth_m: Float32Array) -> Float32Array:
        return _on_the_floor(np.where(dice.random(depth_m.shape) < 0.004, 1.2 * depth_m, depth_m))

    assert all(flight.see_from(ON_THE_PAD, specked, (0.0, 0.0, 0.0)) for _ in range(300))


@pytest.mark.parametrize("wrong", [1, 2, 12])
def test_where_the_camera_stands_as_it_did_pictures_are_accepted_again_though_nothing_shows_a_shift(wrong: int) -> None:
    flight = Flight()
    assert all(flight.see_from(ON_THE_PAD, _on_the_floor, (0.0, 0.0, 0.0)) for _ in range(30))
    assert not any(flight.see_from(ON_THE_PAD, _half_as_far_again, (0.0, 0.0, 0.0)) for _ in range(wrong))
    accepted = [flight.see_from(ON_THE_PAD, _on_the_floor, (0.0, 0.0, 0.0)) for _ in range(12)]
    assert accepted == [False] * 2 + [True] * 10


@pytest.mark.parametrize("pixels", [16, -16])
def test_a_camera_that_stands_still_never_believes_pictures_that_lie_aside(flight: Flight, pixels: int) -> None:
    here = _body(flight.n)
    assert not any(flight.see_from(here, lambda d: np.roll(d, pixels, axis=1), (0.0, 0.0, 0.0)) for _ in range(120))


@pytest.mark.parametrize("turning", [0.10, -0.13])
@pytest.mark.parametrize("pixels", [16, -16])
def test_only_a_view_that_would_show_a_shift_makes_pictures_accepted_again(flight: Flight, pixels: int, turning: float) -> None:
    """Over the floor and before walls that are looked at squarely, a shifted picture fits what was seen there."""
    assert all(flight.see() for _ in range(12))
    flight.turning = turning
    assert not any(flight.see(lambda d: np.roll(d, pixels, axis=1)) for _ in range(60))


def test_where_nothing_comes_back_from_what_was_there_the_picture_is_wrong(flight: Flight) -> None:
    assert not flight.see(lambda d: np.where(d > 0.9, np.nan, d))


def test_a_slow_creep_is_reported(flight: Flight) -> None:
    for n in range(48):
        assert flight.see(off_m=(0.04 * n * PERIOD_S, 0.0, 0.0))
        if flight.drift:
            break
    assert flight.drift is not None
    assert flight.drift.code in (ReasonCode.ODOMETRY_DRIFT, ReasonCode.SURFACES_GONE, ReasonCode.SURFACES_MOVED)


ROUND_ITS_END = (0.57, -0.09, 1.0, 2.6), (-0.335, -0.6, 1.0, 1.9)
TOWARDS_IT = (-2.0, 1.7, 1.2, 0.6), (0.0, 1.2, 1.2, 1.4)
PARTITION_M, CABINET_M = np.array([[-0.055, 0.0, 0.0], [0.055, 2.5, 2.6]]), np.array([[-0.6, 2.07, 0.0], [1.6, 2.5, 2.6]])


@pytest.mark.parametrize(
    ("way", "pictures", "box_m"),
    [(ROUND_ITS_END, 8, PARTITION_M), (ROUND_ITS_END, 12, PARTITION_M), (TOWARDS_IT, 8, CABINET_M)],
    ids=["partition", "partition-slower", "cabinet"],
)
def test_what_stands_along_a_wall_is_no_drift(way: tuple[tuple[float, ...], ...], pictures: int, box_m: FloatArray) -> None:
    """As it was in two generated flats: the other face of a partition 0.11 m thick, and a cabinet before a wall."""
    flight = Flight()
    for n in range(30 + pictures + 12):
        x, y, z, yaw = np.array(way[0]) + np.clip((n - 30) / pictures, 0.0, 1.0) * np.subtract(way[1], way[0])
        assert flight.see_from(Pose.from_yaw(yaw, np.array([x, y, z])), None, (0.0, 0.0, 0.0), box_m)
        assert flight.drift is None


@pytest.mark.parametrize("turning", [0.04, 0.08, 0.12, 0.16])
def test_a_camera_that_turns_on_is_accepted(flight: Flight, turning: float) -> None:
    """Edges hide and show what is behind them, before walls that look the same a little aside."""
    flight.turning = turning
    assert all(flight.see() for _ in range(160))
    assert flight.drift is None


def test_a_frozen_picture_is_not_accepted_once_the_camera_has_moved(flight: Flight) -> None:
    kept = _depth(_body(flight.n) @ BODY_FROM_DEPTH)
    accepted = [flight.see(lambda _: kept) for _ in range(6)]
    assert accepted[0]
    assert not any(accepted[2:])


def test_a_frame_that_repeats_is_no_frame(flight: Flight) -> None:
    """It is not compared, and it neither begins nor prolongs a doubt."""
    for _ in range(20):
        before = _depth(_body(flight.n) @ BODY_FROM_DEPTH)
        assert flight.see(lambda _, shown=before: shown)
        assert not flight.see(lambda _, shown=before: shown)
    assert not flight.see(_shifted)
    for _ in range(2):
        again = _depth(_body(flight.n) @ BODY_FROM_DEPTH)
        flight.see(lambda _, shown=again: shown)
        assert not flight.see(lambda _, shown=again: shown)
    assert flight.see(), "the third in a row that fits"


def test_an_image_that_repeats_is_accepted_again_if_the_camera_rests() -> None:
    """A simulated camera without noise gives the same image on the pad."""
    flight = Flight()
    still = _on_the_floor(_depth(ON_THE_PAD @ BODY_FROM_DEPTH))
    accepted = [flight.see_from(ON_THE_PAD, lambda _: still, (0.0, 0.0, 0.0)) for _ in range(12)]
    assert accepted == [True, False, *[True] * 10]


def test_a_person_that_stands_there_now_is_accepted(flight: Flight) -> None:
    assert all(flight.see(box=True) for _ in range(12))
    assert flight.drift is None
    assert all(flight.see() for _ in range(3))


@pytest.mark.parametrize("way", [(0.05, 0.0, 0.0), (0.0, -0.05, 0.0), (0.0, 0.0, 0.05)])
def test_a_pose_that_drifts_is_reported_before_it_is_half_a_metre_off(flight: Flight, way: tuple[float, float, float]) -> None:
    for n in range(60):
        x, y, z = (n * PERIOD_S * speed for speed in way)
        assert flight.see(off_m=(x, y, z))
        if flight.drift:
            break
    assert 0.10 <= np.linalg.norm((x, y, z)) <= 0.5
    assert flight.drift


def test_a_reported_drift_is_kept_for_a_while(flight: Flight) -> None:
    for n in range(40):
        flight.see(off_m=(0.01 * n, 0.0, 0.0))
    assert flight.drift
    assert flight.monitor.drift(flight.n * PERIOD_S + 3.0) is None


def test_a_jump_of_odom_itself_begins_again(flight: Flight) -> None:
    here = Pose.from_yaw(0.0, np.array([2.0, 1.0, 1.0])) @ BODY_FROM_DEPTH
    frame = Frame(flight.n * PERIOD_S, flight.n, 0.5 * _depth(here), LENS, np.zeros((2, 2, 3), np.uint8), LENS, here)
    assert not flight.see(lambda depth_m: 0.5 * depth_m)
    assert flight.monitor.rejection(frame, CameraMotion.at_rest(here), 1) is None


def _comparison(
    explained: float = 0.92,
    shift_m: float = 0.3,
    count: int = 150,
    age_s: float = 28.0,
    fitting: float = 0.45,
    farther: float = 0.0,
    x_m: float = 0.0,
    turned_rad: float = 0.0,
) -> ViewComparison:
    camera_pose = CameraPose.of(Pose.from_yaw(turned_rad, np.array([x_m, 0.0, 1.0])) @ BODY_FROM_DEPTH)
    return ViewComparison(
        count, fitting, 1.0 - fitting - farther, farther, np.array([0.0, shift_m, 0.0]), np.diag([0.03, 0.84, 0.05]),
        explained, age_s, np.empty((0, 6)), camera_pose,
    )  # fmt: skip


def test_one_view_alone_does_not_tell_of_a_drift() -> None:
    """As it was in two_rooms: what the oldest view saw of a wall now has something before it; the next explains half of it."""
    assert _moved(iter([_comparison(), _comparison(0.95, x_m=0.2), _comparison(0.5)]), 0.9) == Reason(
        ReasonCode.SURFACES_MOVED, (0.3, 28.0)
    )
    assert _moved(iter([_comparison(), _comparison(0.53, x_m=0.2)]), 0.9) is None
    assert _moved(iter([_comparison(), _comparison(shift_m=0.14, x_m=0.2)]), 0.9) is None
    assert _moved(iter([_comparison(), _comparison(count=99, x_m=0.2)]), 0.9) is None
    assert _moved(iter([_comparison(0.53), _comparison(x_m=0.2), _comparison(x_m=0.4)]), 0.9) is None
    assert _moved(iter([_comparison()]), 0.9) is None
    assert _moved(iter([]), 0.9) is None


def test_views_from_one_place_are_one_view() -> None:
    still = [_comparison(age_s=28.0 - n, farther=0.45) for n in range(8)]
    assert _moved(iter(still), 0.9) is None
    assert _seen_through(iter(still)) is None
    assert _moved(iter([*still, _comparison(x_m=0.2)]), 0.9) == Reason(ReasonCode.SURFACES_MOVED, (0.3, 28.0))
    assert _moved(iter([*still, _comparison(turned_rad=0.1)]), 0.9) is not None
    assert _moved(iter([*still, _comparison(0.5), _comparison(x_m=0.2)]), 0.9) is None


def test_surfaces_are_gone_only_if_two_views_from_two_places_say_so() -> None:
    gone, here = _comparison(farther=0.44, age_s=9.0), _comparison(farther=0.39, x_m=0.2)
    assert _seen_through(iter([gone, _comparison(farther=0.41, x_m=0.2)])) == Reason(ReasonCode.SURFACES_GONE, (0.44, 9.0))
    assert _seen_through(iter([gone, here, _comparison(farther=0.44, x_m=0.4)])) is None
    assert _seen_through(iter([gone])) is None
    assert _seen_through(iter([])) is None


def _false_wall(depth_m: Float32Array) -> Float32Array:
    """A wall of 1 m by 1 m, 1.2 m ahead, that is not there: it hides what is behind it."""
    fx, fy, cx, cy = LENS.pinhole_px()
    out, wide, high = depth_m.copy(), 0.5 * fx / 1.2, 0.5 * fy / 1.2
    part = out[max(int(cy - high), 0) : int(cy + high), max(int(cx - wide), 0) : int(cx + wide)]
    part[~(part < 1.2)] = 1.2
    return out


def test_one_false_frame_in_a_turn_reports_no_drift() -> None:
    """The views before it were out of view after the turn, so that it was the oldest one, and what it showed was gone."""
    for false_frame in range(12, 19):
        flight = Flight()
        for n in range(40):
            yaw = np.radians(60.0) * np.clip((n - 12) / 6, 0.0, 1.0)
            flight.see_from(
                Pose.from_yaw(yaw, np.array([0.0, 0.0, 1.2])), _false_wall if n == false_frame else None, (0.0, 0.0, 0.0)
            )
            assert flight.drift is None


def test_a_doubt_after_a_false_frame_that_was_accepted_is_short(flight: Flight) -> None:
    """The false one is the newest view, and nothing fits it: the next ones are held against a view that was confirmed."""
    flight.turning, doubts = 0.16, 0
    for _ in range(40):
        after = copy.deepcopy(flight)
        if after.see(_false_wall) and not after.see(_shifted):
            doubts += 1
            assert any(after.see() for _ in range(5))
        assert flight.see()
    assert doubts >= 30


@pytest.mark.parametrize(("share", "seed"), [(0.03, 1), (0.15, 0), (0.15, 1)])
def test_a_false_wall_in_some_frames_reports_no_drift(share: float, seed: int) -> None:
    """Of a camera that turns to and fro: a view is kept once the next frame confirms it."""
    flight, dice, yaw, goal = Flight(), np.random.default_rng(seed), 0.0, 0.0
    for n in range(300):
        goal = yaw + dice.uniform(-2.5, 2.5) if abs(goal - yaw) < 0.02 and dice.random() < 0.1 else goal
        yaw += np.clip(goal - yaw, -0.06, 0.06)
        place = np.array([0.3 * np.sin(0.07 * n), 0.2 * np.sin(0.05 * n), 1.2])
        flight.see_from(Pose.from_yaw(yaw, place), _false_wall if dice.random() < share else None, (0.0, 0.0, 0.0))
        assert flight.drift is None


def test_a_shift_that_few_points_ask_for_is_no_drift() -> None:
    """As it was over a pad: a sixth of the points were floor, hidden by something as the vehicle climbed; the walls fitted."""
    assert _moved(iter([_comparison(1.0, fitting=0.85), _comparison(1.0, fitting=0.82, x_m=0.2)]), 0.75) is None
    assert _moved(iter([_comparison(1.0, fitting=0.74), _comparison(1.0, fitting=0.74, x_m=0.2)]), 0.75) is not None


@pytest.mark.parametrize("corrects", [True, False])
def test_errors_that_the_poses_share_with_the_frames_are_not_corrected(corrects: bool) -> None:
    monitor = DepthConsistencyMonitor(corrects)
    monitor.calibration_filter.state[DELAY] = 0.02
    monitor.calibration_filter.covariance *= 0.01
    assert (monitor.calibration.delay_s == pytest.approx(0.02)) is corrects
    assert (monitor.calibration.delay_s == 0.0) is not corrects
