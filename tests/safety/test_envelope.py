"""The envelope, densely at its boundary."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uav_recon.safety.envelope import Envelope


def envelope(inset_m: float = 0.3) -> Envelope:
    return Envelope((-1.0, -2.0, -0.1), (5.0, 2.0, 2.4), inset_m, 1.0, 2.0, 0.8)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", ["low", "high"])
def test_the_inset_fence_ends_where_it_says(axis: int, side: str) -> None:
    fence = envelope()
    edge = fence.fence_min_m[axis] + 0.3 if side == "low" else fence.fence_max_m[axis] - 0.3
    outward = -1.0 if side == "low" else 1.0
    for millimetres in range(-20, 21):
        point = [2.5, 0.0, 1.0]
        point[axis] = edge + outward * millimetres * 1e-3
        x, y, z = point
        assert fence.in_box((x, y, z)) is (millimetres <= 0), (axis, side, millimetres)


def test_only_the_floor_is_relaxed_over_the_pad() -> None:
    fence = envelope()
    assert fence.contains((0.0, 0.0, 0.0))
    assert fence.contains((0.49, 0.0, 0.1))
    assert not fence.contains((0.51, 0.0, 0.1))
    assert not fence.contains((0.0, 0.0, -0.21))
    assert not fence.contains((0.0, 0.0, 2.2)), "no ceiling relaxed"
    beside_wall = Envelope((-0.4, -2.0, -0.1), (5.0, 2.0, 2.4), 0.3, 1.0, 2.0, 0.8)
    assert not beside_wall.contains((-0.2, 0.0, 0.1)), "no wall relaxed"


def test_leaving_the_column_sideways_below_the_floor_is_not_admitted() -> None:
    fence = envelope()
    low, outside_box = (0.3, 0.0, 0.1), (0.8, 0.0, 0.1)
    assert fence.contains(low)
    assert not fence.admits(low, outside_box)
    assert not fence.admits(low, (0.8, 0.0, 0.4)), "each end is allowed, the way between is not"
    assert fence.admits((0.3, 0.0, 0.4), (0.8, 0.0, 0.4))


def test_admitted_ways_are_inside_at_every_point_between() -> None:
    fence, rng = envelope(), np.random.default_rng(1)
    admitted = 0
    for _ in range(3000):
        a, b = rng.uniform([-1.2, -2.2, -0.4], [5.2, 2.2, 2.6]), rng.uniform([-1.2, -2.2, -0.4], [5.2, 2.2, 2.6])
        if rng.random() < 0.5:
            a, b = a * 0.2, b * 0.2
        (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
        if not fence.admits((ax, ay, az), (bx, by, bz)):
            continue
        admitted += 1
        for f in np.linspace(0.0, 1.0, 21):
            x, y, z = (a + f * (b - a)).tolist()
            assert fence.contains((x, y, z))
    assert admitted > 300


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_a_number_is_nowhere(bad: float) -> None:
    for axis in range(3):
        point = [0.0, 0.0, 1.0]
        point[axis] = bad
        assert not envelope().contains((point[0], point[1], point[2]))


def test_stopping_point_is_reached_by_braking_at_the_limit() -> None:
    fence = envelope()
    velocity, position = np.array([0.6, -0.5, 0.3]), np.array([1.0, 0.5, 1.0])
    p, v, dt = position.copy(), velocity.copy(), 1e-5
    while (speed := float(np.linalg.norm(v))) > 1e-4:  # integrate a brake: the oracle
        v = v - v / speed * min(fence.max_acceleration_mps2 * dt, speed)
        p = p + v * dt
    vx, vy, vz = velocity.tolist()
    np.testing.assert_allclose(fence.stopping_point((1.0, 0.5, 1.0), (vx, vy, vz)), p, atol=1e-4)


def test_impossible_numbers_are_refused_when_written_down() -> None:
    with pytest.raises(ValueError, match="leaves no room"):
        envelope(inset_m=1.3)
    with pytest.raises(ValueError, match="finite"):
        Envelope((0, 0, math.nan), (1, 1, 1), 0.1, 1.0, 1.0, 1.0)
    with pytest.raises(ValueError, match="positive"):
        Envelope((0, 0, 0), (1, 1, 1), 0.1, 0.0, 1.0, 1.0)
    with pytest.raises(ValueError, match="not negative"):
        Envelope((0, 0, 0), (1, 1, 1), -0.1, 1.0, 1.0, 1.0)
