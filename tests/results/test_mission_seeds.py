"""Median and worst of several missions, and what their calibration is off by."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from results import mission_seeds
from results.mission_seeds import WORST, calibration_off, summary
from sitl.camera.camera_errors import CameraErrors, MountErrors, OpticsErrors, TimingErrors


def flight(seed: int, **figures: Any) -> dict[str, Any]:
    return (
        {"scene": "built-in", "seed": seed, "outcome": "completed", "off_in_sigmas": [0.5]}
        | dict.fromkeys(WORST, 1.0)
        | figures
    )


def test_the_worst_is_the_least_recall_and_the_largest_error() -> None:
    flights = [flight(1, accuracy_cm=0.5, recall_5cm=0.9), flight(2, accuracy_cm=0.7, recall_5cm=0.99), flight(3)]
    flights[2] |= {"accuracy_cm": None, "recall_5cm": None, "outcome": "aborted: no link", "off_in_sigmas": [2.5, 0.1]}
    found = summary(flights)
    assert found["accuracy_cm"] == {"median": pytest.approx(0.6), "worst": 0.7}
    assert found["recall_5cm"]["worst"] == 0.9
    assert (found["flights"], found["completed"]) == (3, 2)
    assert found["honest_share"] == pytest.approx(3 / 4)


def test_an_estimate_is_compared_with_the_camera_that_flew() -> None:
    true = CameraErrors(
        mount=MountErrors(rotation_rad=(0.01, 0.0, 0.0)), optics=OpticsErrors(depth_scale=0.01), timing=TimingErrors(age_s=0.02)
    )
    found = {"depth_scale": (0.012, 0.001), "delay_s": (0.019, 0.002)}
    found |= {"rotation_x_rad": (-0.01, 0.002), "rotation_y_rad": (0.002, 0.002), "rotation_z_rad": (0.0, 0.002)}
    off = calibration_off(found, true)
    assert off["scale_off"] == pytest.approx(0.002)
    assert off["delay_off_ms"] == pytest.approx(1.0)
    assert off["mount_off_deg"] == pytest.approx(math.degrees(0.002))
    assert off["off_in_sigmas"] == pytest.approx([2.0, -0.5, 0.0, 1.0, 0.0])
    assert calibration_off(None, true)["off_in_sigmas"] == []


def test_a_refused_flight_leaves_no_report_of_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "flight.json").write_text('{"report": {}}', encoding="utf-8")
    monkeypatch.setattr("results.mission_seeds.subprocess.run", lambda *_, **__: None)
    assert mission_seeds._fly("built-in", 1, [], tmp_path / "flight") is None
    assert not (tmp_path / "flight.json").exists()


def test_a_flight_of_the_same_commit_is_not_flown_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flown = []

    def fly(scene: str, seed: int, more: list[str], folder: Path) -> dict[str, Any] | None:
        flown.append(seed)
        return None if seed == 3 else flight(seed)

    monkeypatch.setattr(mission_seeds, "_fly", fly)
    file = tmp_path / "seeds.json"
    assert mission_seeds.main(["--scenes", "built-in", "--seeds", "1,2", "--json", str(file)]) == 0
    assert mission_seeds.main(["--scenes", "built-in", "--seeds", "1,2,3", "--json", str(file)]) == 1
    assert flown == [1, 2, 3]
    assert json.loads(file.read_bytes())["summary"]["flights"] == 2
    monkeypatch.setattr("uav_recon.measurement.host_info.revision", lambda: ("another", False))
    assert mission_seeds.main(["--scenes", "built-in", "--seeds", "1", "--json", str(file)]) == 0
    assert flown == [1, 2, 3, 1]
