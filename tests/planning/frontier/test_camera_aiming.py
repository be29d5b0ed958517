"""Best heading of a camera for given directions, against a fine search of all headings."""

from __future__ import annotations

import numpy as np
import pytest
from box_world import FIXED, GIMBAL

from uav_recon.planning.camera_frustum import PITCH_MAX, PITCH_MIN, CameraGeometry, in_view, sight
from uav_recon.planning.frontier.camera_aiming import best_aim, count_in_frustum


@pytest.mark.parametrize("camera", [FIXED, GIMBAL], ids=["fixed", "gimbal"])
def test_as_good_as_a_fine_search(camera: CameraGeometry) -> None:
    lens = camera.lens(0.1, 4.5)
    rng = np.random.default_rng(0)
    mine, best = [], []
    for _ in range(40):
        middle, spread = rng.normal(size=3) * [1.0, 1.0, 0.3], rng.uniform(0.1, 1.0)
        directions = (10.0 * (middle + spread * rng.normal(size=(80, 3)))).T.astype(np.float32).copy()
        most, yaw, pitch = best_aim(lens, directions, 80, 0.3, max(lens[PITCH_MIN], 0.0))
        assert most == count_in_frustum(lens, directions, 80, yaw, pitch)
        assert lens[PITCH_MIN] <= pitch <= lens[PITCH_MAX]
        pitches = np.unique(np.linspace(lens[PITCH_MIN], lens[PITCH_MAX], 25))
        best.append(max(count_in_frustum(lens, directions, 80, a, b) for a in np.arange(0.0, 2 * np.pi, 0.05) for b in pitches))
        mine.append(most)
    assert np.mean(np.array(mine) >= 0.95 * np.array(best)) >= 0.9
    assert min(np.array(mine) / np.array(best)) > 0.8


def test_the_heading_is_unchanged_when_all_directions_are_in_the_image() -> None:
    lens = GIMBAL.lens(0.1, 4.5)
    directions = np.array([[10.0, 12.0], [0.5, -0.5], [0.2, 0.1]], dtype=np.float32)
    assert best_aim(lens, directions, 2, 0.05, 0.0) == (2, 0.05, 0.0)


def test_the_image_limits_equal_those_of_the_camera() -> None:
    lens = GIMBAL.lens(0.1, 4.5)
    rng = np.random.default_rng(1)
    line = sight(lens, np.array([5.0, 6.0, 7.0]), 0.7, 0.2)
    directions = rng.uniform(-20.0, 20.0, (3, 200)).astype(np.float32)
    away = np.linalg.norm(directions, axis=0)
    directions = directions[:, (away > 4.0) & (away < 40.0)].copy()
    shown = sum(in_view(lens, line, *(np.array(line[:3]) + way)) for way in directions.T)
    assert count_in_frustum(lens, directions, directions.shape[1], 0.7, 0.2) == shown
