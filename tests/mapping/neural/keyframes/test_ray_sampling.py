from __future__ import annotations

import numpy as np
import pytest

from uav_recon.mapping.neural.keyframes.ray_buffer import RayBuffer
from uav_recon.mapping.neural.keyframes.ray_records import COLUMNS, DEPTH_UNIT_M
from uav_recon.mapping.neural.keyframes.ray_sampling import DISTANCE_FACTOR, FREE, MIN_TRUST, NEAR, RAYS, draw, make_batch

D435I = 0.08 / (447.0 * 0.05)  # inverse depth, sigma


def weight_of_a_measurement(z_m: float) -> float:
    """Return the total weight of the samples near the surface.

    It is relative to that of a measurement without error.
    """
    records = np.zeros((100, COLUMNS), dtype=np.int16)
    records[:, 2] = round(z_m / DEPTH_UNIT_M)
    replay, batch = RayBuffer(), make_batch()
    replay.add(records, np.eye(3), np.zeros(3), D435I, np.ones(2))
    low, high = np.full(3, -9.0, dtype=np.float32), np.full(3, 9.0, dtype=np.float32)
    draw(np.array([7], dtype=np.uint64), replay.views, 1, low, high, batch)
    near = batch.weight.reshape(RAYS, NEAR + FREE)[:, :NEAR]
    return float(near.sum()) * 0.01 / float(DISTANCE_FACTOR)  # losses are in units of 10 cm


def test_a_measurement_weighs_by_its_variance_and_that_of_poses() -> None:
    assert weight_of_a_measurement(1.0) == pytest.approx(1.0 / (1.0 + (D435I / 0.01) ** 2), rel=1e-3)
    assert weight_of_a_measurement(2.0) == pytest.approx(1.0 / (1.0 + (4.0 * D435I / 0.01) ** 2), rel=1e-3)


def test_a_surface_seen_only_from_far_away_has_the_minimum_weight() -> None:
    assert weight_of_a_measurement(5.0) == pytest.approx(float(MIN_TRUST), rel=1e-3)
