"""AUTOPILOTS.md: SET_POSITION_TARGET_LOCAL_NED on the simulated ArduCopter, and its end."""

from __future__ import annotations

import itertools
import math

import pytest
from ardupilot_rig import GUIDED, LAND, PLACE_ONLY, PLACE_SPEED_YAW, Copilot, flying, mode_of
from pymavlink.dialects.v20 import common as mavlink


def east_at(c: Copilot, speed: float, seconds: float) -> None:
    """Stream position, speed and yaw along north for some seconds, as a companion does."""
    begin = c.now_s
    c.type_mask = PLACE_SPEED_YAW
    c.setpoint = lambda now: (speed * (now - begin), 0.0, -1.2, speed, 0.0, 0.0, 0.0, 0.0, 0.0, 1.27, 0.0)
    c.run(seconds)


def test_the_type_mask_has_the_documented_value() -> None:
    assert sum(1 << bit for bit in (6, 7, 8, 11)) == PLACE_SPEED_YAW


def test_position_speed_and_yaw_are_followed_around_a_square() -> None:
    c = flying()
    corners, side_s, worst = [(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0), (0.0, 0.0)], 5.0, 0.0
    for (x0, y0), (x1, y1) in itertools.pairwise(corners):
        begin = c.now_s

        def smooth(
            now: float, x0: float = x0, y0: float = y0, x1: float = x1, y1: float = y1, t0: float = begin
        ) -> tuple[float, ...]:
            s = min((now - t0) / side_s, 1.0)
            p, v = s**3 * (10 - 15 * s + 6 * s * s), 30 * s * s * (1 - s) ** 2 / side_s
            dx, dy = x1 - x0, y1 - y0
            return (x0 + p * dx, y0 + p * dy, -1.2, v * dx, v * dy, 0.0, 0.0, 0.0, 0.0, 1.27, 0.0)

        c.setpoint = smooth
        for _ in range(50):
            c.run(0.1)
            wanted = smooth(c.now_s)
            worst = max(worst, math.dist(c.ned[:2], wanted[:2]))
    assert worst < 0.2


@pytest.mark.parametrize("way", ["place, speed, yaw", "speed"])
def test_when_setpoints_stop_the_vehicle_stops_and_hovers_for_ever(way: str) -> None:
    c = flying(GUID_TIMEOUT=3.0 if way == "speed" else 0.5)
    if way == "speed":
        c.move(0.3, 0.0)
        c.run(3.0)
        timeout_s, speed = 3.0, 0.3
    else:
        east_at(c, 0.8, 3.0)
        timeout_s, speed = 0.5, 0.8
    place = c.ned
    c.setpoint = None
    c.run(timeout_s - 0.1)
    assert c.speed > 0.7 * speed
    c.run(0.6)
    assert c.speed < 0.6 * speed
    c.run(2.5)
    assert c.speed < 0.12
    assert math.dist(c.ned, place) < speed * timeout_s + 0.5
    rest = c.ned
    c.run(60.0)
    assert mode_of(c) == "GUIDED"
    assert c.copter.failsafes == []
    assert math.dist(c.ned, rest) < 0.4


def test_a_position_only_setpoint_is_held_for_ever() -> None:
    c = flying()
    c.stay(1.5, 0.0, -1.2)
    c.run(0.2)
    c.setpoint = None
    c.run(10.0)
    assert c.away_from(1.5, 0.0, -1.2) < 0.15


@pytest.mark.parametrize(
    ("mask", "what"),
    [
        (0b110000111000, "place and acceleration"),
        (0b110111111111, "nothing at all"),
        (PLACE_SPEED_YAW | 1, "speed with a broken place"),
    ],
)
def test_unsupported_masks_hold_the_position(mask: int, what: str) -> None:
    c = flying()
    c.type_mask = mask
    c.setpoint = lambda _t: (3.0, 0.0, -1.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.27, 0.0)
    c.run(4.0)
    assert c.away_from(0.0, 0.0, -1.2) < 0.15, what


@pytest.mark.parametrize("odd", [math.nan, math.inf])
def test_numbers_that_are_not_finite_hold_the_position(odd: float) -> None:
    c = flying()
    c.setpoint = lambda _t: (3.0, 0.0, -1.2, odd, 0.0, 0.0, 0.0, 0.0, 0.0, 1.27, 0.0)
    c.run(3.0)
    assert c.away_from(0.0, 0.0, -1.2) < 0.15


def test_other_frames_hold_the_position() -> None:
    c = flying()
    for _ in range(60):
        c.send(mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, mavlink.MAV_FRAME_LOCAL_ENU, 0, 3.0, *[0.0] * 10))
        c.run(0.05)
    assert c.away_from(0.0, 0.0, -1.2) < 0.15


def test_a_position_is_flown_at_the_parameters_speed_and_a_velocity_at_its_own() -> None:
    for way, low, high in (("place", 0.6, 0.9), ("speed", 1.7, 2.3)):
        c = flying(WP_SPD=0.8)
        if way == "place":
            c.stay(20.0, 0.0, -1.2)
        else:
            c.move(2.0, 0.0)
        fastest = 0.0
        for _ in range(60):
            c.run(0.1)
            fastest = max(fastest, c.speed)
        assert low < fastest < high, way


def test_a_new_setpoint_in_the_air_ends_the_take_off() -> None:
    c = flying()
    c.go_to(0.0, 0.0, -0.8, 1.27)
    c.run(4.0)
    assert c.away_from(0.0, 0.0, -0.8) < 0.1


def test_setpoints_count_only_in_guided() -> None:
    c = flying()
    count = len(c.copter.setpoint_arrivals_s)
    c.go_to(0.0, 0.0, -1.2, 1.27)
    c.run(2.0)
    assert len(c.copter.setpoint_arrivals_s) - count == pytest.approx(60, abs=2)
    assert c.set_mode(LAND) == 0
    count = len(c.copter.setpoint_arrivals_s)
    c.run(1.0)
    assert len(c.copter.setpoint_arrivals_s) == count


def test_the_fence_silently_drops_positions_outside() -> None:
    c = flying(FENCE_RADIUS=6.0)
    texts = len(c.texts)
    c.stay(7.0, 0.0, -1.2)
    c.run(6.0)
    assert c.away_from(0.0, 0.0, -1.2) < 0.15
    assert mode_of(c) == "GUIDED"
    assert len(c.texts) == texts


def test_a_velocity_can_breach_the_fence_which_lands() -> None:
    c = flying(FENCE_RADIUS=6.0, AVOID_ENABLE=0)
    c.move(1.0, 0.0)
    assert c.run(12.0, lambda: mode_of(c) == "LAND")
    assert c.ned[0] == pytest.approx(6.03, abs=0.1)
    assert c.copter.failsafes == ["Fence breached: LAND"]
    assert c.run(15.0, lambda: not c.armed)
    assert c.ned[0] < 7.0


def test_avoidance_stops_a_velocity_at_the_margin() -> None:
    c = flying(FENCE_RADIUS=6.0)
    c.move(1.0, 0.0)
    c.run(15.0)
    assert c.ned[0] == pytest.approx(5.5, abs=0.2)
    assert mode_of(c) == "GUIDED"


def test_the_yaw_rate_stays_below_the_parameter() -> None:
    c = flying()
    c.go_to(0.0, 0.0, -1.2, -1.5)
    fastest = 0.0
    for _ in range(40):
        c.run(0.1)
        fastest = max(fastest, abs(c.vehicle.gyro[2]))
    assert math.radians(80.0) < fastest < math.radians(100.0)


def test_after_a_failsafe_guided_is_granted_and_the_flight_continues() -> None:
    """A companion must never request GUIDED again by itself, because the autopilot would obey."""
    c = flying(SCR_ENABLE=0)
    c.heartbeats = False
    assert c.run(4.0, lambda: mode_of(c) == "LAND")
    assert c.set_mode(GUIDED) == 0
    c.type_mask = PLACE_ONLY
    c.setpoint = lambda _t: (0.0, 0.0, -1.2, *[0.0] * 8)
    c.run(3.0)
    assert mode_of(c) == "GUIDED"
    assert c.away_from(0.0, 0.0, -1.2) < 0.2


def test_a_landing_in_motion_brakes_within_the_limits_of_guided() -> None:
    c = flying(WP_ACC=1.0)
    c.move(0.9, 0.0)
    c.run(4.0)
    begun = c.ned
    assert c.set_mode(LAND) == 0
    c.setpoint = None
    strongest, before = 0.0, c.speed
    for _ in range(100):
        c.run(0.02)
        strongest, before = max(strongest, (before - c.speed) / 0.02), c.speed
    way = math.hypot(c.ned[0] - begun[0], c.ned[1] - begun[1])
    assert 0.35 < way < 0.85  # 0.9^2 / 2, the effect of the jerk limit, and 0.1 s for the command
    assert strongest < 1.4
    assert c.speed < 0.1
