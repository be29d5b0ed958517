from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uav_recon import config as configuration
from uav_recon.app.unseen_space import unseen_space
from uav_recon.config import Config
from uav_recon.recording.report import ReportUnseen
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN, GridSpec, VoxelMap

FLOWN = Path(__file__).parents[2] / "systemd" / "config.toml"
LOW_M, HIGH_M = (-1.7, -1.3, -0.1), (1.7, 1.3, 2.4)  # a room of 3.4 x 2.6 x 2.5 m


def _config(tilt_deg: float, takeoff_top_m: float | None = None) -> Config:
    tree = configuration.load(FLOWN).model_dump(mode="json", exclude_none=True)
    tree["safety"] |= {"fence_min_m": LOW_M, "fence_max_m": HIGH_M, "fence_inset_m": 0.3, "vehicle_height_m": 0.2}
    tree["planner"]["clearance_m"], tree["mission"]["views"], tree["camera"]["pitch_down_deg"] = 0.4, 50, tilt_deg
    tree["voxels"] = {} if takeoff_top_m is None else {"takeoff_top_m": takeoff_top_m}
    return configuration.parse(tree, "test")


def _found(config: Config, known_to_m: float, views: int = 20) -> ReportUnseen:
    """Return what is unseen if the left half of the map is the room, known up to a height over the floor."""
    grid = GridSpec.covering(np.array(LOW_M) - 0.3, np.array(HIGH_M) + 0.3, 0.1)
    state = np.full(grid.shape, UNKNOWN, dtype=np.uint8)
    top = int(grid.index(np.array([0.0, 0.0, known_to_m - 0.1 + 0.05]))[2])
    state[: grid.shape[0] // 2, :, :top] = FREE
    state[: grid.shape[0] // 2, :, :3] = OCCUPIED
    found = unseen_space(VoxelMap.whole(grid, state, np.zeros(grid.shape, np.uint8), 1), config, views)
    assert found is not None
    return found


def test_a_tilt_that_misses_the_upper_part_is_named_with_a_better_one() -> None:
    found = _found(_config(15.0), 2.1)
    assert found.upper_share == pytest.approx(0.5, abs=0.07)  # of 0.8 m the upper 0.4 m
    assert found.lower_share == 0.0
    assert "of the room above 1.7 m was out of the camera's sight: a tilt of 5° would have shown 0.96" in found.text
    assert "15° shows 0.81" in found.text


def test_with_a_tilt_that_fits_the_reason_is_another() -> None:
    assert "voxels.takeoff_top_m" in _found(_config(5.0), 2.1).text
    assert _found(_config(5.0, 2.2), 2.1).text.endswith("was not seen")
    assert "the view budget of 50 is too small" in _found(_config(5.0), 2.1, views=50).text


def test_a_room_that_is_known_is_not_mentioned() -> None:
    assert _found(_config(15.0), 2.5).text == ""


def test_without_a_room_nothing_is_unseen() -> None:
    grid = GridSpec(np.array([-2.0, -2.0, -0.4]), 0.1, (40, 40, 30))
    nothing = VoxelMap.whole(grid, np.zeros(grid.shape, np.uint8), np.zeros(grid.shape, np.uint8), 1)
    assert unseen_space(nothing, _config(15.0), 0) is None
