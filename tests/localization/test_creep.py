"""Shifts against views of the last seconds, as many looks back tell of them together."""

from __future__ import annotations

import numpy as np
import pytest

from uav_recon.localization.creep import Creep
from uav_recon.localization.witness import Agreement
from uav_recon.types.frames import FloatArray

PERIOD_S = 1.0 / 6.0
EVERYWHERE, ONE_WALL = np.diag([0.3, 0.3, 0.4]), np.diag([0.0, 0.6, 0.4])


def _then(age_s: float, shift_m: FloatArray, held: FloatArray = EVERYWHERE, explained: float = 1.0) -> Agreement:
    return Agreement(200, explained, 0.0, 0.0, shift_m, held, explained, age_s)


def _heard(
    velocity: tuple[float, float, float],
    seconds: float,
    held: FloatArray = EVERYWHERE,
    noise_m: float = 0.0,
    explained: float = 1.0,
) -> Creep:
    creep, dice = Creep(), np.random.default_rng(4)
    for n in range(round(seconds / PERIOD_S)):
        age_s = 1.0 + 0.5 * (n % 3)
        shift = held.any(axis=1) * (np.array(velocity) * age_s + noise_m * dice.standard_normal(3))
        creep.hear(10.0 + n * PERIOD_S, _then(age_s, shift, held, explained))
    return creep


def test_what_creeps_is_told_of_and_where_to() -> None:
    found = _heard((0.05, 0.0, 0.0), 12.0).velocity_mps
    np.testing.assert_allclose(found, (0.05, 0.0, 0.0), atol=0.01)


def test_noise_of_two_centimetres_is_little() -> None:
    assert np.linalg.norm(_heard((0.0, 0.0, 0.0), 30.0, noise_m=0.02).velocity_mps) < 0.006


def test_along_a_bare_wall_nothing_can_be_told() -> None:
    assert np.linalg.norm(_heard((0.05, 0.0, 0.0), 20.0, ONE_WALL).velocity_mps) < 1e-9
    assert _heard((0.05, 0.05, 0.0), 20.0, ONE_WALL).velocity_mps[1] == pytest.approx(0.05, abs=0.005)


def test_views_of_the_first_three_seconds_tell_nothing() -> None:
    """On the pad the filter settles by some centimetres."""
    creep = Creep()
    for n in range(1, 18):
        creep.hear(10.0 + n * PERIOD_S, _then(min(n * PERIOD_S, 0.8), np.array([0.05, 0.0, 0.0])))
    assert not creep.velocity_mps.any()
    creep.hear(14.2, _then(0.8, np.array([0.05, 0.0, 0.0])))
    assert creep.velocity_mps[0] > 0.0


def test_what_no_shift_explains_tells_nothing() -> None:
    assert not _heard((0.05, 0.0, 0.0), 12.0, explained=0.6).velocity_mps.any()


def test_what_was_told_fades_and_a_new_odom_begins_anew() -> None:
    creep = _heard((0.05, 0.0, 0.0), 12.0)
    for n in range(180):
        creep.hear(22.0 + n * PERIOD_S, _then(1.5, np.zeros(3)))
    assert np.linalg.norm(creep.velocity_mps) < 0.002
    creep = _heard((0.05, 0.0, 0.0), 12.0)
    creep.forget()
    assert not creep.velocity_mps.any()


def test_a_pause_counts_as_a_moment() -> None:
    creep = Creep()
    creep.hear(10.0, None)
    creep.hear(20.0, _then(1.0, np.array([0.05, 0.0, 0.0])))
    assert np.linalg.norm(creep.velocity_mps) < 0.02
