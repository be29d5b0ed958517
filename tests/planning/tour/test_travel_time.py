"""Travel times of paths, against a second implementation of the formula."""

from __future__ import annotations

import numpy as np
import pytest

from uav_recon.planning.tour.travel_time import BRAKING_MPS2, LEAVING_TURN_SHARE, YawThenFly, YawWhileFlying, leave
from uav_recon.types.frames import FloatArray

SPEED_MPS, RATE_RADPS, BLIND_MPS, OFF_RAD = 0.8, 0.7, 0.27, 0.6
ON_THE_WAY = YawWhileFlying(SPEED_MPS, RATE_RADPS)
NOSE_FIRST = YawThenFly(SPEED_MPS, RATE_RADPS, BLIND_MPS, OFF_RAD, 0.47)
TILT_RAD = float(np.radians(15.0))


def turn(a_rad: float, b_rad: float) -> float:
    return float(np.abs(np.angle(np.exp(1j * (b_rad - a_rad)))))


def straight(places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return lengths (N, N) and unit directions (N, N, 3) between positions (N, 3)."""
    away = places[None] - places[:, None]
    lengths_m = np.linalg.norm(away, axis=2)
    return lengths_m, away / np.maximum(lengths_m, 1e-12)[:, :, None]


def test_costs_are_the_longer_of_flight_and_turn_plus_the_first_turn_and_braking() -> None:
    rng = np.random.default_rng(0)
    lengths_m = rng.uniform(0, 6, (6, 6))
    departures = rng.normal(size=(6, 6, 3))
    departures /= np.linalg.norm(departures, axis=2, keepdims=True)
    departures[2, 3] = 0.0  # does not move
    departures[3, 2] = (0.0, 0.0, 1.0)  # straight up: no heading to turn to
    yaws_rad, velocity = rng.uniform(-9, 9, 6), np.array([0.3, -0.5, 0.1])
    costs = ON_THE_WAY.seconds(lengths_m, departures, yaws_rad, np.zeros(6))
    leave(costs, departures, velocity)
    for i in range(6):
        for j in range(6):
            leaving = 0.0
            if np.hypot(departures[i, j, 0], departures[i, j, 1]) > 0.1:
                leaving = turn(yaws_rad[i], np.arctan2(departures[i, j, 1], departures[i, j, 0]))
            expected = max(lengths_m[i, j] / 0.8, turn(yaws_rad[i], yaws_rad[j]) / 0.7) + LEAVING_TURN_SHARE * leaving / 0.7
            if i == 0:
                expected += (np.linalg.norm(velocity) - departures[i, j] @ velocity) / BRAKING_MPS2
            assert costs[i, j] == pytest.approx(expected)


@pytest.mark.parametrize("travel_time_model", [ON_THE_WAY, NOSE_FIRST])
def test_an_unreachable_task_has_infinite_cost(travel_time_model: YawWhileFlying | YawThenFly) -> None:
    lengths_m = np.array([[0.0, np.inf], [np.inf, 0.0]])
    costs = travel_time_model.seconds(lengths_m, np.zeros((2, 2, 3)), np.zeros(2), np.zeros(2))
    assert np.isinf(costs[0, 1])
    assert np.isfinite(costs[0, 0])


@pytest.mark.parametrize(
    ("from_deg", "to_deg", "seconds"),
    [
        (0.0, 0.0, 4.0 / SPEED_MPS),
        (180.0, 0.0, (np.pi - OFF_RAD) / RATE_RADPS + OFF_RAD / RATE_RADPS + 4.0 / SPEED_MPS),
        (0.0, 90.0, np.pi / 2 / RATE_RADPS + 4.0 / SPEED_MPS),
        (30.0, 30.0, 4.0 / SPEED_MPS),
        (-180.0, 180.0, 2 * (np.pi - OFF_RAD) / RATE_RADPS + 4.0 / SPEED_MPS),
    ],
)
def test_nose_first_turns_before_and_after_a_path(from_deg: float, to_deg: float, seconds: float) -> None:
    lengths_m, departures = straight(np.array([[0.0, 0.0, 1.0], [4.0, 0.0, 1.0]]))
    costs = NOSE_FIRST.seconds(lengths_m, departures, np.radians([from_deg, to_deg]), np.full(2, TILT_RAD))
    assert costs[0, 1] == pytest.approx(seconds)
    assert costs[0, 0] == costs[1, 1] == 0.0


@pytest.mark.parametrize("goal", [(0.3, 0.0, 1.0), (2.0, 0.0, 2.2), (0.0, 0.0, 0.5)])
def test_short_or_steep_paths_are_flown_slowly_without_a_turn(goal: tuple[float, float, float]) -> None:
    lengths_m, departures = straight(np.array([[0.0, 0.0, 1.0], goal]))
    costs = NOSE_FIRST.seconds(lengths_m, departures, np.full(2, np.pi / 2), np.full(2, TILT_RAD))
    assert costs[0, 1] == pytest.approx(lengths_m[0, 1] / BLIND_MPS)


def test_on_a_bend_the_vehicle_turns_to_the_final_direction_on_the_path() -> None:
    """The path starts north and ends east: the vehicle yaws from one to the other on the way."""
    lengths_m = np.array([[0.0, 5.0], [5.0, 0.0]])
    departures = np.zeros((2, 2, 3))
    departures[0, 1], departures[1, 0] = (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)
    costs = NOSE_FIRST.seconds(lengths_m, departures, np.radians([90.0, 0.0]), np.full(2, TILT_RAD))
    assert costs[0, 1] == pytest.approx(np.pi / 2 / RATE_RADPS + 5.0 / SPEED_MPS)
