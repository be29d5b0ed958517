from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sitl.world.spline_trajectory import REST_S, SPIN_UP_S, Rates, SplineTrajectory, Waypoint

ABOVE = Waypoint((0.0, 0.0, 1.0), 0.3)
COORDINATES = st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(0.5, 1.5))
LEGS = st.lists(st.tuples(COORDINATES, st.floats(-math.pi, math.pi), st.floats(-0.5, 0.5)), min_size=1, max_size=5)


def flight(legs: list[tuple[tuple[float, float, float], float, float]], rates: Rates | None = None) -> SplineTrajectory:
    return SplineTrajectory(0.3, [ABOVE, *(Waypoint(*leg) for leg in legs)], rates)


@given(LEGS)
@settings(max_examples=30, deadline=None)
def test_speed_and_turn_rates_are_never_exceeded(legs: list[tuple[tuple[float, float, float], float, float]]) -> None:
    trajectory = flight(legs)
    s = trajectory.states(np.arange(0.0, trajectory.duration_s, 0.02))
    assert np.linalg.norm(s.velocity_mps, axis=1).max() <= 0.6 + 1e-9
    rotation = Rotation.from_quat(s.quat_wxyz[:, [1, 2, 3, 0]])
    heading = np.unwrap(np.arctan2(*rotation.apply([1.0, 0.0, 0.0]).T[[1, 0]]))
    assert np.abs(np.diff(heading) / 0.02).max() <= math.radians(45.0) + 0.05  # tilt turns the heading a little
    assert np.abs(np.diff(s.pitch_down_rad) / 0.02).max() <= math.radians(30.0) + 1e-9


@given(LEGS)
@settings(max_examples=15, deadline=None)
def test_inertial_values_are_those_of_the_motion(legs: list[tuple[tuple[float, float, float], float, float]]) -> None:
    trajectory = flight(legs)
    step_s = 0.002
    s = trajectory.states(np.arange(0.0, trajectory.duration_s, step_s))
    rotation = Rotation.from_quat(s.quat_wxyz[:, [1, 2, 3, 0]])
    turned = (rotation[:-1].inv() * rotation[1:]).as_rotvec() / step_s
    middle = 0.5 * (s.gyro_radps[1:] + s.gyro_radps[:-1])
    assert np.abs(turned - middle).max() < 2e-3
    acceleration = (s.position_m[2:] - 2 * s.position_m[1:-1] + s.position_m[:-2]) / step_s**2
    force = rotation[1:-1].inv().apply(acceleration + np.array([0.0, 0.0, 9.80665]))
    assert np.abs(force - s.specific_force_mps2[1:-1]).max() < 1e-2
    assert np.abs(s.specific_force_mps2[:, :2]).max() < 1e-9, "a quadrotor's thrust is along its z axis"


def test_it_rests_on_the_pad_and_in_the_air() -> None:
    trajectory = flight([((2.0, 1.0, 1.2), 1.0, 0.0)])
    before = trajectory.states(np.linspace(0.0, REST_S + SPIN_UP_S, 50))
    assert np.abs(before.position_m).max() < 1e-12
    assert np.abs(before.gyro_radps).max() < 1e-9
    assert before.motors_on.tolist() == [bool(t >= REST_S) for t in np.linspace(0.0, REST_S + SPIN_UP_S, 50)]
    end = trajectory.states(np.array([trajectory.duration_s - 0.01, trajectory.duration_s + 5.0]))
    assert end.position_m == pytest.approx(np.tile([2.0, 1.0, 1.2], (2, 1)), abs=1e-6)
    assert np.linalg.norm(end.velocity_mps, axis=1).max() < 1e-6


def test_a_bend_is_rounded_inside_the_corner() -> None:
    trajectory = flight([((2.0, 0.0, 1.0), 0.0, 0.0), ((2.0, 2.0, 1.0), 0.0, 0.0)])
    s = trajectory.states(np.arange(0.0, trajectory.duration_s, 0.01))
    miss = np.linalg.norm(s.position_m - [2.0, 0.0, 1.0], axis=1).min()
    assert 0.03 < miss < 0.15
    assert s.position_m[:, 0].max() <= 2.0 + 1e-9
    tilt = np.arccos(np.clip(Rotation.from_quat(s.quat_wxyz[:, [1, 2, 3, 0]]).apply([0.0, 0.0, 1.0])[:, 2], -1, 1))
    assert math.radians(2.0) < tilt.max() < math.radians(12.0)
