"""Plots are complete for every flight, an empty one included.

Their appearance was checked by eye.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from flight_inputs import INSIDE, mesh, voxel_map, write_timeline

from uav_recon.recording.flight_log import Timeline, read_timeline
from uav_recon.recording.mesh_renders import render_mesh_images
from uav_recon.recording.plots import coverage_over_time, path_over_plan, place_sigma_over_time, planning_over_time
from uav_recon.types.frames import ByteArray
from uav_recon.types.maps import TriangleMesh

EMPTY = Timeline((), (), (), (), (), (), (), (), (), 0)


def loaded(path: Path) -> ByteArray:
    image = cv2.imread(str(path))
    assert image is not None, path
    return np.asarray(image, dtype=np.uint8)


@pytest.fixture
def timeline(tmp_path: Path) -> Timeline:
    write_timeline(tmp_path)
    return read_timeline(tmp_path)


def test_flight_plots_have_content(tmp_path: Path, timeline: Timeline) -> None:
    path_over_plan(tmp_path / "p" / "path.png", timeline, voxel_map())
    coverage_over_time(tmp_path / "p" / "coverage.png", timeline)
    coverage_over_time(tmp_path / "p" / "share.png", timeline, free_volume_m3=25.0)
    planning_over_time(tmp_path / "p" / "planning.png", timeline)
    place_sigma_over_time(tmp_path / "p" / "place.png", timeline)
    for name in ("path", "coverage", "share", "planning", "place"):
        image = loaded(tmp_path / "p" / f"{name}.png")
        assert image.shape[1] == 1200 and 300 < image.shape[0] < 1400
        assert 0.01 < np.mean(image < 250) < 0.9


def test_an_empty_flight_still_has_its_plots(tmp_path: Path) -> None:
    path_over_plan(tmp_path / "path.png", EMPTY, None)
    path_over_plan(tmp_path / "plan.png", EMPTY, voxel_map())
    coverage_over_time(tmp_path / "coverage.png", EMPTY)
    planning_over_time(tmp_path / "planning.png", EMPTY)
    place_sigma_over_time(tmp_path / "place.png", EMPTY)
    assert len(list(tmp_path.glob("*.png"))) == 5


def test_both_uncertainties_of_the_place_are_drawn(tmp_path: Path, timeline: Timeline) -> None:
    def drawn(*unknown: str) -> tuple[int, int]:
        """Return the number of orange and of blue pixels."""
        changed: dict[str, Any] = dict.fromkeys(unknown)
        samples = tuple(dataclasses.replace(sample, **changed) for sample in timeline.progress)
        place_sigma_over_time(tmp_path / "place.png", dataclasses.replace(timeline, progress=samples))
        blue, _, red = (loaded(tmp_path / "place.png")[..., k].astype(int) for k in range(3))
        return int(np.sum(red > blue + 120)), int(np.sum(blue > red + 120))

    (orange, blue), without_measured, without_predicted = drawn(), drawn("measured_sigma_m"), drawn("predicted_sigma_m")
    assert without_measured[0] < orange - 800 and without_measured[1] == pytest.approx(blue, rel=0.1)
    assert without_predicted[1] < blue - 800 and without_predicted[0] == pytest.approx(orange, rel=0.1)
    assert min(without_measured[0], without_predicted[1]) > 800  # the limits of each


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return render_mesh_images(tmp_path_factory.mktemp("mesh"), mesh(), INSIDE)


def test_the_near_walls_and_the_ceiling_are_left_out_of_the_views_from_outside(written: list[Path]) -> None:
    assert [path.name for path in written] == ["mesh_colour.png", "mesh_uncertainty.png", "mesh_top.png"]
    for path in written:
        image = loaded(path)
        assert image.shape == (800, 1200, 3)
        assert (image[:2, :2] == 255).all()  # white around the model
    blue, green, red = (loaded(written[0])[..., k].astype(int) for k in range(3))
    assert np.mean((green > red + 30) & (green > blue + 30)) > 0.1  # the floor
    assert np.mean((red > green + 60) & (red > blue + 60)) < 0.01  # no ceiling except the rim of the walls
    top = loaded(written[2])[400, 600].astype(int)
    assert top[1] > top[0] + 30 and top[1] > top[2] + 30


def test_uncertainty_goes_from_blue_to_red(written: list[Path]) -> None:
    path = written[1]
    blue, _, red = (loaded(path)[..., k].astype(int) for k in range(3))
    assert np.mean(blue > red + 60) > 0.01 and np.mean(red > blue + 60) > 0.01


def test_an_empty_mesh_gives_no_images(tmp_path: Path) -> None:
    nothing = TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros((0, 3), np.uint8), np.zeros(0, np.float32))
    assert render_mesh_images(tmp_path, nothing, INSIDE) == []
