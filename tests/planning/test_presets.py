from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from box_world import FIXED, GIMBAL

from uav_recon.config import PlannerConfig
from uav_recon.planning.camera_frustum import CameraGeometry
from uav_recon.planning.presets import derived
from uav_recon.types.frames import FloatArray

ZERO = np.zeros(3)
MEETING = np.array([6.21, 4.96, 2.43])


def auto(size_m: FloatArray, camera: CameraGeometry = FIXED, **written: float) -> PlannerConfig:
    return derived(PlannerConfig.model_validate(written), ZERO, size_m, camera)


def test_rooms_of_30_square_metres_get_the_proven_parameters() -> None:
    found = auto(MEETING)
    for key, flown in {
        "shell_min_m": 0.8, "shell_max_m": 2.5, "local_radius_m": 2.0, "cluster_radius_m": 1.1, "max_reconstruct_tasks": 10,
        "min_visible": 20, "near_distance_m": 1.5, "horizon_m": 5.0, "end_factor": 3.0,
    }.items():  # fmt: skip
        assert getattr(found, key) == pytest.approx(flown, rel=0.05), key
    assert found.shell_max_m > 2.0  # far enough to see ceilings with a camera fixed 15 degrees down
    assert found.clearance_m == PlannerConfig().clearance_m


def test_the_parameters_follow_the_room() -> None:
    small, middle, large = (auto(np.array([side, side, 2.5])) for side in (4.5, 6.0, 8.0))
    for key in ("local_radius_m", "near_distance_m", "horizon_m", "max_reconstruct_tasks"):
        assert getattr(small, key) < getattr(middle, key) < getattr(large, key), key
    building, larger = auto(np.array([26.0, 25.0, 3.0])), auto(np.array([90.0, 72.0, 3.0]))
    assert building == larger
    assert building.local_radius_m < 3.0


def test_the_parameters_follow_the_camera() -> None:
    narrow = dataclasses.replace(FIXED, vfov_rad=np.radians(40))
    near_sighted = dataclasses.replace(FIXED, surface_range_m=1.5)
    assert auto(MEETING, narrow).cluster_radius_m < auto(MEETING).cluster_radius_m
    assert auto(MEETING, narrow).max_reconstruct_tasks > auto(MEETING).max_reconstruct_tasks
    assert auto(MEETING, near_sighted).shell_max_m < 1.5


@pytest.mark.parametrize("side_m", [0.8, 1.5, 3.0, 5.0, 9.0, 40.0, 200.0])
@pytest.mark.parametrize("camera", [FIXED, GIMBAL, dataclasses.replace(FIXED, surface_range_m=0.6, range_m=0.5)])
def test_for_every_box_the_parameters_are_valid(side_m: float, camera: CameraGeometry) -> None:
    for size_m in ([side_m, side_m, 2.0], [side_m, 1.0, 2.0], [side_m, 30.0, 6.0]):
        found = auto(np.array(size_m), camera)
        again = PlannerConfig.model_validate(found.model_dump(exclude_none=True))  # all limits of the config are kept
        assert again == found
        assert found.shell_min_m < found.shell_max_m


def test_configured_values_win_and_a_second_derivation_changes_nothing() -> None:
    found = auto(MEETING, horizon_m=9.0, min_visible=3)
    assert (found.horizon_m, found.min_visible) == (9.0, 3)
    assert found.shell_max_m != PlannerConfig().shell_max_m
    assert derived(found, ZERO, MEETING, FIXED) == found
    assert derived(found, ZERO, 2 * MEETING, GIMBAL) == found


@pytest.mark.parametrize(
    ("preset", "row"),
    [
        ("bhxhp", (1.0, 2.0, 2.5, 1.3, 15, 30, 2.0, 6.0)),
        ("rosser", (0.8, 1.8, 2.0, 1.1, 10, 20, 1.5, 5.0)),
        ("convoy", (0.5, 1.5, 1.5, 1.0, 10, 15, 1.0, 4.0)),
    ],
)
def test_the_papers_table(preset: str, row: tuple[float, ...]) -> None:
    config = derived(PlannerConfig.model_validate({"preset": preset}), ZERO, MEETING, GIMBAL)
    found = [
        config.shell_min_m, config.shell_max_m, config.local_radius_m, config.cluster_radius_m, config.max_reconstruct_tasks,
        config.min_visible, config.near_distance_m, config.horizon_m,
    ]  # fmt: skip
    assert found == list(row)
    assert (config.view_spacing_m, config.end_factor, config.near_count, config.near_share) == (0.2, 3.0, 3, 0.2)
    assert PlannerConfig.model_validate(config.model_dump()) == config
