"""PX4's trajectories in its own modes, against closed forms of jerk-limited motion."""

from __future__ import annotations

import math
import random

import pytest

from sitl.autopilots.px4.trajectory_smoothing import SmoothingLimits, TrajectorySmoothing

LIMITS = SmoothingLimits(speed=1.0, acceleration=2.0, jerk=4.0)


def brake(velocity: float, dt_s: float) -> tuple[float, float]:
    """Return the time (s) and distance (m) to rest."""
    motion, steps = TrajectorySmoothing(0.0, velocity), 0
    while abs(motion.velocity) > 1e-6:
        motion.step(dt_s, 0.0, LIMITS)
        steps += 1
    return steps * dt_s, motion.position


@pytest.mark.parametrize("dt_s", [0.004, 0.02])
@pytest.mark.parametrize("velocity", [-1.2, 0.4, 0.8, 1.2, 3.0])
def test_braking_takes_the_shortest_possible_time(velocity: float, dt_s: float) -> None:
    speed, most, jerk = abs(velocity), LIMITS.acceleration, LIMITS.jerk
    shortest = 2.0 * math.sqrt(speed / jerk) if speed * jerk <= most**2 else speed / most + most / jerk
    took_s, way_m = brake(velocity, dt_s)
    assert took_s == pytest.approx(shortest, abs=1.01 * dt_s + 1e-3)
    assert way_m == pytest.approx(velocity * shortest / 2.0, rel=1e-3)  # the profile is symmetrical in time


def test_acceleration_and_jerk_keep_their_limits_for_any_command() -> None:
    dice, motion, wanted = random.Random(1), TrajectorySmoothing(), 0.0
    for k in range(20_000):
        if k % 37 == 0:
            wanted = dice.uniform(-2.0, 2.0)
        before = motion.velocity, motion.acceleration
        motion.step(0.004, wanted, LIMITS)
        assert abs(motion.acceleration) <= LIMITS.acceleration + 1e-9
        assert abs(motion.acceleration - before[1]) <= LIMITS.jerk * 0.004 + 1e-9
        assert abs(motion.velocity - before[0]) <= LIMITS.acceleration * 0.004 + 1e-9


def test_a_speed_is_reached_without_overshoot_and_kept() -> None:
    motion, fastest = TrajectorySmoothing(), 0.0
    for _ in range(1000):
        motion.step(0.01, 0.9, LIMITS)
        fastest = max(fastest, motion.velocity)
    assert fastest == pytest.approx(0.9)
    assert motion.velocity == pytest.approx(0.9)
    assert motion.acceleration == 0.0


@pytest.mark.parametrize("velocity", [0.2, 0.8, 1.2])
def test_it_stops_at_the_hold_position_without_overshoot(velocity: float) -> None:
    place = LIMITS.stopping_m(velocity)
    assert place == pytest.approx(velocity**2 / 4.0 + 0.6 * velocity)
    motion, farthest = TrajectorySmoothing(0.0, velocity), 0.0
    for _ in range(2500):
        motion.step(0.004, LIMITS.speed_towards(place - motion.position), LIMITS)
        farthest = max(farthest, motion.position)
    assert motion.position == pytest.approx(place, abs=1e-3)
    assert farthest <= place + 1e-6


def test_a_position_is_approached_only_as_fast_as_braking_allows() -> None:
    assert LIMITS.speed_towards(0.0) == 0.0
    assert LIMITS.speed_towards(50.0) == 1.0
    assert LIMITS.speed_towards(-50.0) == -1.0
    speed = LIMITS.speed_towards(0.3)  # v^2 = 2 a (x - v * 2 a / j), TrajMath.hpp
    assert speed**2 == pytest.approx(2.0 * 2.0 * (0.3 - speed * 2.0 * 2.0 / 4.0))
