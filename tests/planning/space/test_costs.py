"""Seconds of a way are what the formula says, written a second time."""

from __future__ import annotations

import numpy as np
import pytest

from uav_recon.planning.space.costs import BRAKING_MPS2, LEAVING_TURN_SHARE, seconds


def turn(a_rad: float, b_rad: float) -> float:
    return float(np.abs(np.angle(np.exp(1j * (b_rad - a_rad)))))


def test_the_costs_are_flying_or_turning_and_leaving_and_braking() -> None:
    rng = np.random.default_rng(0)
    lengths_m = rng.uniform(0, 6, (6, 6))
    departures = rng.normal(size=(6, 6, 3))
    departures /= np.linalg.norm(departures, axis=2, keepdims=True)
    departures[2, 3] = 0.0  # does not move
    departures[3, 2] = (0.0, 0.0, 1.0)  # straight up: no heading to turn to
    yaws_rad, velocity = rng.uniform(-9, 9, 6), np.array([0.3, -0.5, 0.1])
    costs = seconds(lengths_m, departures, yaws_rad, velocity, 0.8, 0.7)
    for i in range(6):
        for j in range(6):
            leaving = 0.0
            if np.hypot(departures[i, j, 0], departures[i, j, 1]) > 0.1:
                leaving = turn(yaws_rad[i], np.arctan2(departures[i, j, 1], departures[i, j, 0]))
            expected = max(lengths_m[i, j] / 0.8, turn(yaws_rad[i], yaws_rad[j]) / 0.7) + LEAVING_TURN_SHARE * leaving / 0.7
            if i == 0:
                expected += (np.linalg.norm(velocity) - departures[i, j] @ velocity) / BRAKING_MPS2
            assert costs[i, j] == pytest.approx(expected)


def test_what_cannot_be_reached_costs_more_than_anything() -> None:
    costs = seconds(np.array([[0.0, np.inf], [np.inf, 0.0]]), np.zeros((2, 2, 3)), np.zeros(2), np.zeros(3), 0.8, 0.7)
    assert np.isinf(costs[0, 1])
    assert np.isfinite(costs[0, 0])
