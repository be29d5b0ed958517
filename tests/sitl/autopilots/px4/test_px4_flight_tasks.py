"""AUTOPILOTS.md: a complete flight of the simulated PX4, and its physics."""

from __future__ import annotations

import math
from typing import Any

import pytest
from px4_rig import companion, flying
from pymavlink.dialects.v20 import common as mavlink
from scripted_companion import LAND, Companion

from sitl.autopilots.px4.autopilot import Px4
from sitl.autopilots.px4.parameters import Px4Parameters
from sitl.world.quadrotor import Quadrotor
from sitl.world.step_sizes import FINE_STEPS


def square(start_s: float, side: float, speed: float) -> tuple[Any, float]:
    """Return a smooth square at constant height with feedforward, and its duration.

    Each side is flown from rest to rest with minimum jerk.
    """
    leg_s = 1.875 * side / speed
    corners = [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side), (0.0, 0.0)]

    def at(now_s: float) -> tuple[float, ...]:
        t = max(now_s - start_s, 0.0)
        leg = min(int(t / leg_s), 3)
        u = min(t / leg_s - leg, 1.0)
        s = u**3 * (10 - 15 * u + 6 * u * u)
        v = 30 * u * u * (1 - u) ** 2 / leg_s
        a = 60 * u * (1 - u) * (1 - 2 * u) / leg_s**2
        (x0, y0), (x1, y1) = corners[leg], corners[leg + 1]
        dx, dy = x1 - x0, y1 - y0
        return (x0 + s * dx, y0 + s * dy, -1.2, v * dx, v * dy, 0.0, a * dx, a * dy, 0.0, 1.27, 0.0)

    return at, 4 * leg_s


@pytest.mark.parametrize(("wind_mps", "widest"), [(0.0, 0.05), (0.15, 0.07)])
def test_a_complete_flight_with_a_square_and_a_landing(wind_mps: float, widest: float) -> None:
    c = Companion(Px4Parameters.load(), 2, wind_mps)
    c.take_off()
    path, duration = square(c.now_s, 2.0, 0.8)
    c.setpoint = path
    along = across = 0.0
    for _ in range(round(duration / 0.05)):
        c.run(0.05)
        x, y, z = c.ned
        along = max(along, c.away_from(*path(c.now_s)[:3]))
        side = max(abs(x - 1.0), abs(y - 1.0)) - 1.0  # distance from the outline, outwards or inwards
        across = max(across, abs(side), abs(z + 1.2))
    assert along < 0.12
    assert across < widest
    c.run(1.0)
    assert c.away_from(0.0, 0.0, -1.2) < 0.05
    assert c.set_mode(LAND) == 0
    assert c.run(15.0, lambda: not c.armed)
    assert c.vehicle.position[2] == 0.0
    assert c.away_from(0.0, 0.0, 0.0) < 0.1
    assert c.px4.failsafes == []
    assert len(c.vehicle.touchdowns) == 1
    assert c.vehicle.touchdowns[0] < 0.6


def test_corners_of_a_smooth_path_are_cut_by_no_more_than_5_cm() -> None:
    c = Companion(Px4Parameters.load(), 3, wind_mps=0.0)
    c.take_off()
    start = c.now_s
    radius, speed = 0.5, 0.8

    def circle(now_s: float) -> tuple[float, ...]:
        """Return a point on a tight turn at 0.8 m/s (1.28 m/s^2 sideways), eased in over 2 s."""
        t = now_s - start
        w = speed / radius
        ease = min(t / 2.0, 1.0)
        angle = w * (t - 1.0) if t > 2.0 else w * t * t / 4.0
        rate, spin = w * ease, (w / 2.0 if t < 2.0 else 0.0)
        cos, sin = math.cos(angle), math.sin(angle)
        return (
            radius * sin, radius * (1 - cos), -1.2, radius * cos * rate, radius * sin * rate, 0.0,
            radius * (cos * spin - sin * rate**2), radius * (sin * spin + cos * rate**2), 0.0, 1.27, 0.0,
        )  # fmt: skip

    c.setpoint = circle
    errors = []
    for _ in range(1000):
        c.run(0.01)
        errors.append(abs(math.hypot(c.ned[0], c.ned[1] - radius) - radius))
    assert max(errors) < 0.05


def test_equal_seeds_give_bit_identical_flights() -> None:
    def end(seed: int) -> tuple[Any, ...]:
        c = companion(seed)
        c.take_off(0.5)
        return (c.vehicle.position, c.px4.estimator.position, tuple(c.px4.setpoint_arrivals_s))

    assert end(4) == end(4)
    assert end(4) != end(5)


def test_physics_runs_in_fixed_steps_independent_of_the_callers_rate() -> None:
    a, b = companion(), companion()
    a.px4.step(501.0)
    for i in range(1, 1001):
        b.px4.step(500.0 + i * 0.001)
    assert a.px4.truth() == b.px4.truth()
    assert a.px4.truth().stamp_s == pytest.approx(501.0, abs=FINE_STEPS.physics_s)


class LateReader:
    """Link whose one datagram arrives 0.6 s after the autopilot's first step."""

    arrival_s = 500.6

    def __init__(self) -> None:
        self._codec = mavlink.MAVLink(None, 42, 191)
        self._waiting = [bytes(mavlink.MAVLink_timesync_message(0, 77).pack(self._codec))]
        self.written = b""

    def read(self) -> bytes:
        return self._waiting.pop() if self._waiting else b""

    def write(self, data: bytes) -> None:
        self.written += data


def test_a_late_call_processes_messages_at_their_arrival_times() -> None:
    link = LateReader()
    px4 = Px4(Quadrotor(1), link, Px4Parameters.load(), 1)
    px4.step(500.0)
    px4.step(501.0)
    heard = mavlink.MAVLink(None, 1, 1).parse_buffer(link.written)
    answer = next(m for m in heard if m.get_type() == "TIMESYNC" and m.ts1 == 77)
    assert answer.tc1 * 1e-9 == pytest.approx(37.5 + 0.6, abs=2 * FINE_STEPS.physics_s)


def test_the_camera_tilts_with_the_body() -> None:
    c = flying()
    c.go_to(3.0, 0.0, -1.2)
    steepest = 0.0
    for _ in range(200):
        c.run(0.01)
        w, x, y, _ = c.px4.truth().quat_wxyz
        steepest = max(steepest, 2.0 * math.hypot(x, y) / max(abs(w), 0.5))
    assert math.radians(4.0) < steepest < math.radians(30.0)


def test_a_failsafe_that_is_not_simulated_is_refused_at_the_start() -> None:
    with pytest.raises(ValueError, match="COM_OBL_RC_ACT 3"):
        companion(COM_OBL_RC_ACT=3)
