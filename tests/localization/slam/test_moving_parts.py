"""Something crosses before a wall, seen by a camera that stands or moves itself."""

from __future__ import annotations

import numpy as np
import pytest

from uav_recon.localization.slam.moving_parts import MovingParts
from uav_recon.types.camera import Frame, Intrinsics, body_from_camera
from uav_recon.types.frames import Float32Array
from uav_recon.types.pose import Pose

LENS = Intrinsics.from_fov(160, 96, 1.52, 1.01)
CAMERA = body_from_camera(np.zeros(3), 0.0)
PERIOD_S = 1.0 / 6.0
WALL_M = 4.0
COLOUR = np.zeros((1, 1, 3), np.uint8)


def _depth(body_m: slice | None, body_away_m: float = 1.5, wall_m: float = WALL_M) -> Float32Array:
    depth_m = np.full((96, 160), wall_m, np.float32)
    if body_m is not None:
        depth_m[20:80, body_m] = body_away_m
    return depth_m


def _frame(n: int, depth_m: Float32Array) -> Frame:
    return Frame(n * PERIOD_S, n, depth_m, LENS, COLOUR, LENS, Pose.identity())


def _at(x: float) -> Pose:
    return Pose.from_yaw(0.0, np.array([x, 0.0, 1.0])) @ CAMERA


@pytest.fixture
def parts() -> MovingParts:
    made = MovingParts()
    for n in range(6):
        frame = _frame(n, _depth(None))
        assert made.without(frame, _at(0.0)) is frame
    return made


def test_what_crosses_is_left_out_and_the_wall_stays(parts: MovingParts) -> None:
    for n in range(5):
        body = slice(20 + 20 * n, 60 + 20 * n)
        still = parts.without(_frame(6 + n, _depth(body)), _at(0.0)).depth_m
        assert np.isnan(still[20:80, body]).all()
        assert np.isfinite(np.delete(still, np.r_[body], axis=1)).mean() > 0.95
        assert np.nanmin(still) == WALL_M
        assert parts.moved_s == (6 + n) * PERIOD_S


def test_what_stays_belongs_to_the_room_after_a_while(parts: MovingParts) -> None:
    for n in range(12):
        frame = _frame(6 + n, _depth(slice(60, 100)))
        still = parts.without(frame, _at(0.0))
        assert (still is frame) == (n >= 6), "within 1.5 s the views with the wall become few"


def test_a_camera_that_moves_sees_nothing_move() -> None:
    """It flies at 0.6 m/s towards a wall and a pillar, and its pose is wrong by 5 cm now and then."""
    parts, dice = MovingParts(), np.random.default_rng(1)
    for n in range(20):
        x = 0.6 * PERIOD_S * n
        frame = _frame(n, _depth(slice(70, 90), 3.5 - x, WALL_M - x))
        assert parts.without(frame, _at(x + float(dice.uniform(-0.05, 0.05)))) is frame
    assert parts.moved_s == -np.inf


def test_where_most_of_the_view_moves_the_track_is_wrong(parts: MovingParts) -> None:
    frame = _frame(6, _depth(slice(0, 160), 2.0))
    assert parts.without(frame, _at(0.0)) is frame


def test_after_a_new_start_nothing_moves(parts: MovingParts) -> None:
    parts.forget()
    frame = _frame(6, _depth(slice(40, 80)))
    assert parts.without(frame, _at(0.0)) is frame
