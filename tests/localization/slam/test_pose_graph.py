"""Pose graph: a loop is closed, and variances are those of the dense problem."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.localization.slam.pose_graph import PoseGraph
from uav_recon.types.pose import Pose

COUNT, LAP = 60, 30
SIGMA_RAD, SIGMA_M = 0.002, 0.004
INFORMATION = np.diag([SIGMA_RAD**-2] * 3 + [SIGMA_M**-2] * 3)


def _circle() -> list[Pose]:
    """Two laps of a circle of 2 m, looking outwards."""
    angles = 2.0 * math.pi * np.arange(COUNT) / LAP
    return [Pose.from_yaw(float(a), np.array([2 * math.cos(a), 2 * math.sin(a), 0.3 * math.sin(2 * a)])) for a in angles]


def _walked(seed: int, *, loops: bool) -> tuple[PoseGraph, list[Pose], list[Pose]]:
    """Return the graph, the poses by its chain alone, and the true ones."""
    random, true = np.random.default_rng(seed), _circle()
    graph, walked = PoseGraph(), [true[0]]

    def noisy(step: Pose) -> Pose:
        return step @ Pose.from_rotation_vector(random.normal(0.0, SIGMA_RAD, 3), random.normal(0.0, SIGMA_M, 3))

    for n in range(1, COUNT):
        step = noisy(true[n - 1].inverse() @ true[n])
        walked.append(walked[-1] @ step)
        graph.add(n - 1, n, walked[n - 1], walked[n], INFORMATION)
        if loops and n >= LAP:
            again = noisy(true[n - LAP].inverse() @ true[n])
            graph.add(n - LAP, n, walked[n - LAP], walked[n - LAP] @ again, INFORMATION)
    return graph, walked, true


def _arrays(poses: list[Pose]) -> tuple[np.ndarray, np.ndarray]:
    return np.stack([pose.rotation() for pose in poses]), np.stack([pose.translation_m for pose in poses])


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 1000))
def test_loops_take_out_the_drift(seed: int) -> None:
    graph, walked, true = _walked(seed, loops=True)
    rotation, place_m = graph.solve(*_arrays(walked))
    off_m = np.linalg.norm(place_m - _arrays(true)[1], axis=1)
    before_m = np.linalg.norm(_arrays(walked)[1] - _arrays(true)[1], axis=1)
    assert off_m.mean() < max(before_m.mean(), 0.02)
    assert off_m[LAP:].mean() < 0.06
    np.testing.assert_allclose(place_m[0], true[0].translation_m, atol=1e-6)
    np.testing.assert_allclose(rotation @ np.swapaxes(rotation, 1, 2), np.tile(np.eye(3), (COUNT, 1, 1)), atol=1e-9)


def test_a_chain_stays_where_it_was_walked() -> None:
    graph, walked, _ = _walked(1, loops=False)
    rotation, place_m = _arrays(walked)
    disturbed_m = place_m + 0.02 * np.random.default_rng(0).standard_normal(place_m.shape)
    disturbed_m[0] = place_m[0]
    found, found_m = graph.solve(rotation, disturbed_m)
    np.testing.assert_allclose(found_m, place_m, atol=1e-4)
    np.testing.assert_allclose(found, rotation, atol=1e-4)


def test_variances_grow_along_a_chain_and_are_those_of_resistors_in_parallel() -> None:
    graph, walked, _ = _walked(2, loops=False)
    rotation = _arrays(walked)[0]
    step = SIGMA_M**2 + 0.01**2  # noise, and calibration
    np.testing.assert_allclose(graph.variances(rotation)[:, 0], step * np.arange(COUNT), rtol=1e-3)
    closed, _, _ = _walked(2, loops=False)
    closed.add(0, COUNT - 1, walked[0], walked[-1], INFORMATION)
    way = np.arange(COUNT) * step
    back = step + step * np.arange(COUNT)[::-1]
    np.testing.assert_allclose(closed.variances(rotation)[1:, 1], (way * back / (way + back))[1:], rtol=1e-3)


def test_what_a_pair_does_not_show_it_does_not_hold() -> None:
    """Along a bare wall: the pair knows the distance to it, x, and not the way along it, y."""
    graph = PoseGraph()
    there = Pose.from_yaw(0.0, np.array([0.5, 0.2, 0.0]))
    graph.add(0, 1, Pose.identity(), there, np.diag([1e8] * 3 + [1e6, 0.0, 1e6]))
    graph.add(0, 1, Pose.identity(), Pose.from_yaw(0.0, np.array([0.6, 0.4, 0.0])), np.diag([1.0] * 3 + [100.0] * 3))
    rotation, place_m = graph.solve(*_arrays([Pose.identity(), there]))
    np.testing.assert_allclose(place_m[1], [0.5, 0.4, 0.0], atol=1e-3)
    assert np.diff(np.sqrt(graph.variances(rotation)[1, :2]))[0] > 0.05
