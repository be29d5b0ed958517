"""A whole mission in lockstep: it ends well, leaves a complete folder, and a seed gives the same flight byte for byte."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from short_training import short_training

from sitl.apps.sim import simulate
from sitl.apps.sim_options import SimOptions
from sitl.camera.camera_errors import FILE_NAME, CameraErrors
from uav_recon import config
from uav_recon.recording.flight_log import read_timeline
from uav_recon.recording.report import Report
from uav_recon.recording.review import check_recording
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

pytestmark = pytest.mark.slow
VIEWS = 12
NIGHTLY_VIEWS = 22


@dataclass
class Flight:
    folder: Path
    report: Report
    truth: dict[str, Any]


def fly(folder: Path, seed: int) -> Flight:
    with short_training():
        assert simulate(SimOptions(views=VIEWS, seed=seed, lockstep=True, mount="fixed:15", out=folder)) == 0
    with np.load(folder / "truth.npz") as truth:
        return Flight(folder, Report.load(folder / "report.json"), {name: truth[name] for name in truth.files})


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> list[Flight]:
    """One flight with the neural mapper."""
    return [fly(tmp_path_factory.mktemp("flight") / "f", 3)]


def test_the_mission_is_completed_without_contact(flights: list[Flight]) -> None:
    for flight in flights:
        report = flight.report
        assert report.outcome == "completed"
        spent = Reason(ReasonCode.VIEWS_SPENT, (VIEWS,))
        assert report.stop_reason.startswith(spent.text())
        assert read_timeline(flight.folder).outcomes[-1].stop_codes[:1] == spent.codes()
        assert report.views == VIEWS
        assert report.safety.contacts == 0
        assert report.safety.failsafes == 0
        assert report.safety.fence_overshoot_m == 0.0
        assert report.safety.min_clearance_m is not None
        assert report.safety.min_clearance_m >= 0.10
        assert report.safety.way_in_sight is not None
        assert report.safety.way_in_sight_nose_first is not None
        assert 0.0 <= report.safety.way_in_sight < report.safety.way_in_sight_nose_first < 1.0


def test_the_model_is_metric_where_it_was_seen(flights: list[Flight]) -> None:
    for flight in flights:
        assert flight.report.quality is not None
        assert flight.report.quality.accuracy_cm is not None
        assert 0.1 < flight.report.quality.accuracy_cm < 3.5  # a short flight: the camera's errors are not known at once
        assert flight.report.explored_fraction is not None
        assert 0.3 < flight.report.explored_fraction < 1.0


@pytest.mark.nightly
def test_a_longer_flight_with_the_usual_training_is_as_accurate(tmp_path: Path) -> None:
    assert simulate(SimOptions(views=NIGHTLY_VIEWS, seed=3, lockstep=True, mount="fixed:15", out=tmp_path / "f")) == 0
    report = Report.load(tmp_path / "f" / "report.json")
    assert report.views == NIGHTLY_VIEWS
    assert report.safety.contacts == 0
    assert report.quality is not None
    assert report.quality.accuracy_cm is not None
    assert 0.1 < report.quality.accuracy_cm < 3.5


def test_the_drone_ends_on_its_pad_with_motors_off(flights: list[Flight]) -> None:
    for flight in flights:
        assert not flight.truth["armed"][-1]
        assert flight.truth["armed"].any()
        assert np.linalg.norm(flight.truth["position_m"][-1][:2]) < 0.3
        assert abs(flight.truth["position_m"][-1][2]) < 0.02


@pytest.mark.nightly
def test_a_seed_gives_the_same_flight_byte_for_byte(flights: list[Flight], tmp_path: Path) -> None:
    first, again = flights[0], fly(tmp_path / "f", 3)
    for name in ("stamp_s", "position_m", "quat_wxyz", "setpoint_arrivals_s"):
        assert first.truth[name].tobytes() == again.truth[name].tobytes(), name
    assert (first.folder / "flight.tlog").read_bytes() == (again.folder / "flight.tlog").read_bytes()
    assert (first.folder / "mesh.ply").read_bytes() == (again.folder / "mesh.ply").read_bytes()


def test_the_flight_folder_is_complete(flights: list[Flight]) -> None:
    folder = flights[0].folder
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") >= 6
    assert len(json.loads((folder / "keyframes" / "poses.json").read_text())["keyframes"]) == VIEWS
    assert config.load(folder / "config.toml").mission.views == VIEWS
    assert check_recording(folder)
    assert (folder / "flight.tlog").stat().st_size > 100_000


def test_setpoints_are_regular_and_inside_the_fence(flights: list[Flight]) -> None:
    for flight in flights:
        stream = flight.report.stream
        assert stream.rate_hz is not None
        assert stream.gap_max_ms is not None
        assert stream.rate_hz > 29.0
        assert stream.gap_max_ms <= 60.0


@pytest.fixture(scope="module")
def quick_flights(tmp_path_factory: pytest.TempPathFactory) -> list[Flight]:
    """Two of the same seed and one of another, with a stand-in for the mapper, by a vehicle of 0.15 m, in a generated flat."""
    flights = []
    for seed in (3, 3, 4):
        folder = tmp_path_factory.mktemp("quick") / "f"
        options = SimOptions(
            scene="random:7",
            views=NIGHTLY_VIEWS,
            seed=seed,
            radius_m=0.15,
            mapper="depth-only",
            lockstep=True,
            mount="fixed:15",
            out=folder,
        )
        assert simulate(options) == 0
        with np.load(folder / "truth.npz") as truth:
            report = Report.load(folder / "report.json")
            flights.append(Flight(folder, report, {name: truth[name] for name in truth.files}))
    return flights


@pytest.mark.nightly
def test_a_quick_flight_is_a_flight(quick_flights: list[Flight]) -> None:
    for flight in quick_flights:
        report = flight.report
        assert report.outcome == "completed"
        assert 8 <= report.views <= NIGHTLY_VIEWS
        assert report.safety.contacts == 0
        assert report.safety.failsafes == 0
        assert report.quality is None
        assert report.explored_fraction is not None
        assert report.explored_fraction > 0.3
        assert report.odometry is not None
        assert report.odometry.turn_deg < 5.0, "the map has the axes of the fence"
        assert report.stream.rate_hz is not None
        assert report.stream.rate_hz > 29.0
        assert config.load(flight.folder / "config.toml").safety.vehicle_radius_m == 0.15


@pytest.mark.nightly
def test_quick_flights_repeat_byte_for_byte(quick_flights: list[Flight]) -> None:
    first, again, other = quick_flights
    for name in ("stamp_s", "position_m", "quat_wxyz", "hull_m", "setpoint_arrivals_s"):
        assert first.truth[name].tobytes() == again.truth[name].tobytes(), name
    assert (first.folder / "flight.tlog").read_bytes() == (again.folder / "flight.tlog").read_bytes()
    assert first.truth["position_m"].tobytes() != other.truth["position_m"].tobytes()


@pytest.mark.nightly
def test_flights_with_camera_errors_repeat_byte_for_byte_and_keep_the_errors(tmp_path: Path) -> None:
    flown = []
    for name, scale in (("first", "default"), ("again", "default"), ("exact", "none")):
        folder = tmp_path / name
        options = SimOptions(
            views=6,
            seed=3,
            mapper="depth-only",
            camera="small",
            lockstep=True,
            mount="fixed:15",
            out=folder,
            camera_errors=scale,
        )
        simulate(options)
        flown.append((folder / "flight.tlog").read_bytes())
        assert CameraErrors.load(folder / FILE_NAME) == CameraErrors.drawn(3, options.camera_error_scale)
    assert flown[0] == flown[1] != flown[2]


@pytest.mark.nightly
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_a_mission_by_the_autopilots_own_navigation_is_completed(tmp_path: Path, autopilot: str) -> None:
    options = SimOptions(
        scene="random:7", views=NIGHTLY_VIEWS, seed=3, radius_m=0.15, mapper="depth-only", lockstep=True, mount="fixed:15",
        out=tmp_path / "f",
        autopilot=autopilot, pose="autopilot",
    )  # fmt: skip
    assert simulate(options) == 0
    report = Report.load(tmp_path / "f" / "report.json")
    assert report.outcome == "completed"
    assert (report.safety.contacts, report.safety.failsafes) == (0, 0)
