from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sequence_of_noise import sequence_of_noise
from typer.testing import CliRunner

from sitl.apps import rgbd_sequences, sequence_faults
from sitl.apps.rgbd_sequences import RgbdSequence, SequenceOptions
from sitl.bench.slam import frame_trackers, slam_bench
from sitl.bench.slam.frame_trackers import METHODS
from sitl.scene.scene import Scene
from uav_recon.cli.choices import TRACKERS
from uav_recon.cli.main import app
from uav_recon.measurement.result_file import HEADER
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.pose import Pose, StampedPose


class ScaledTruth:
    """Tracker that knows the truth, 1 % too long, and loses what it does not see."""

    def __init__(self, sequence: RgbdSequence) -> None:
        self._sequence = sequence

    def add_imu(self, samples: list[ImuSample]) -> None:
        """Ignore samples."""

    def track(self, frame: Frame, body_from_depth: Pose) -> StampedPose | None:
        if not np.isfinite(frame.depth_m).any():
            return None
        truth = self._sequence.true_body_at(np.array([frame.stamp_s]))[0]
        truth[:3, 3] *= 1.01
        return StampedPose(frame.stamp_s, Pose.from_matrix(truth), np.zeros(3))


def bench(*arguments: str) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, ["bench", "slam", *arguments])
    return done.exit_code, done.stdout, done.stderr


@pytest.fixture
def recordings(monkeypatch: pytest.MonkeyPatch) -> list[SequenceOptions]:
    """Replace recording and the product's tracker; returns the options of what was recorded."""
    made: list[SequenceOptions] = []
    sequence = sequence_of_noise()

    def record(options: SequenceOptions, scene: Scene, report: rgbd_sequences.Progress) -> RgbdSequence:
        made.append(options)
        report(1, 1)
        return sequence

    monkeypatch.setattr(rgbd_sequences, "record", record)
    monkeypatch.setitem(frame_trackers.METHODS, "joint", lambda: ScaledTruth(sequence))
    monkeypatch.setattr(sequence_faults, "FIRST_S", 8.0)
    monkeypatch.setattr(sequence_faults, "EVERY_S", 5.0)
    return made


def test_a_row_for_each_sequence_and_a_summary(recordings: list[SequenceOptions], tmp_path: Path) -> None:
    written = tmp_path / "slam.json"
    arguments = ("--scene", "random:3", "--scene", "built-in", "--paths", "2", "--method", "joint")
    code, out, errors = bench(*arguments, "--mount", "gimbal", "--camera-errors", "0.5", "--json", str(written))
    assert code == 0, errors
    assert [(o.scene, o.path, o.seed) for o in recordings] == [
        (scene, path, seed) for scene in ("random:3", None) for path in (0, 1) for seed in (0,)
    ]
    assert {(o.gimbal, o.camera_errors, o.length_m, o.glass) for o in recordings} == {(True, 0.5, 20.0, False)}
    result = json.loads(written.read_text())
    assert set(result) == {HEADER, "summary", "sequences", "about"}
    assert len(result["sequences"]) == 4
    row, summary = result["sequences"][0], result["summary"]["joint"]
    assert row["drift_percent"] == pytest.approx(math.sin(1.0), rel=0.02), "the chord of 2 m of path is 2 sin(1) m"
    assert row["ate_cm"] == pytest.approx(1.0, rel=0.02), "1 % of a circle of 1 m"
    assert summary["sequences"] == 4
    assert summary["ate_cm"] == {"median": pytest.approx(row["ate_cm"]), "worst": pytest.approx(row["ate_cm"])}
    assert row["lost"] == row["false_good"] == 0.0
    assert 0.0 <= row["median_ms"] <= row["p95_ms"]
    assert result["about"]["camera_errors"] == 0.5
    for word in ("random:3", "built-in", "median", "worst", "drift", "ATE", result["about"]["commit"]):
        assert word in out


@pytest.mark.nightly
def test_a_fault_in_windows_is_timed(recordings: list[SequenceOptions], tmp_path: Path) -> None:
    written = tmp_path / "slam.json"
    code, out, errors = bench("--method", "joint", "--fault", "covered", "--json", str(written))
    assert code == 0, errors
    result = json.loads(written.read_text())
    (row,), reactions = result["sequences"], result["summary"]["joint"]["reactions"]
    assert [round(reaction["begin_s"]) for reaction in row["reactions"]] == [8, 13]
    assert all(reaction["reported_s"] == reaction["back_s"] == 0.0 for reaction in row["reactions"])
    assert reactions == {
        "windows": 2, "reported_in_time": 1.0, "reported_s": 0.0, "back_in_time": 1.0, "back_s": 0.0, "false_good_s": 0.0,
    }  # fmt: skip
    assert "reactions to the fault" in out
    code, out, _ = bench("--method", "joint", "--fault", "false-wall")
    assert code == 0
    assert "0%" in out, "this tracker does not notice a false wall"


@pytest.mark.nightly
def test_faults_of_the_recording_reach_it(recordings: list[SequenceOptions]) -> None:
    assert bench("--method", "joint", "--fault", "glass")[0] == 0
    assert bench("--method", "joint", "--fault", "fast-yaw")[0] == 0
    assert recordings[0].glass
    assert recordings[1].yaw_radps == pytest.approx(math.radians(120.0))


def test_a_tracker_that_never_answers_is_the_worst(
    recordings: list[SequenceOptions], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    class Silent(ScaledTruth):
        def track(self, frame: Frame, body_from_depth: Pose) -> StampedPose | None:
            return None

    monkeypatch.setitem(frame_trackers.METHODS, "open3d", lambda: Silent(sequence_of_noise(4)))
    written = tmp_path / "slam.json"
    code, _, errors = bench("--json", str(written))
    assert code == 0, errors
    result = json.loads(written.read_text())
    assert list(result["summary"]) == ["joint", "open3d"]
    assert result["summary"]["open3d"]["ate_cm"]["worst"] is None
    assert result["summary"]["open3d"]["lost"]["worst"] == 1.0


def test_summary_is_median_and_worst() -> None:
    keys = ("drift_percent", "rotation_deg", "median_ms", "p95_ms", "lost", "false_good", "within_claimed")
    rows: list[dict[str, Any]] = [
        {"method": "joint", "ate_cm": ate, "reactions": [], **dict.fromkeys(keys, 1.0)} for ate in (3.0, 9.0, 4.0, None, 2.0)
    ]
    found = slam_bench.summary(rows)["joint"]
    assert found["ate_cm"] == {"median": 4.0, "worst": math.inf}
    assert found["within_claimed"] == {"mean": 1.0, "worst": 1.0}
    rows[1] |= {"within_claimed": None}
    assert slam_bench.summary(rows)["joint"]["within_claimed"] == {"mean": 0.8, "worst": 0.0}, (
        "a track that is lost keeps no claim"
    )
    assert "reactions" not in found
    reactions: list[dict[str, Any]] = [
        {"reported_s": 0.3, "back_s": 2.0, "false_good_s": 0.1},
        {"reported_s": 0.31, "back_s": 2.1, "false_good_s": 4.0},
        {"reported_s": None, "back_s": None, "false_good_s": 0.0},
    ]
    shares = slam_bench.reaction_summary(reactions)
    assert shares["reported_in_time"] == pytest.approx(1 / 3)
    assert shares["back_in_time"] == pytest.approx(1 / 3)
    assert (shares["reported_s"], shares["back_s"], shares["false_good_s"]) == (0.31, 2.1, 4.0)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("--seeds 0", "--seeds 0: want 1 to 100"),
        ("--paths 101", "--paths 101: want 1 to 100"),
        ("--length 1", "--length 1: want 2 to 200 m"),
        ("--mount fixed:30", "--mount fixed:30: want one of fixed:15, gimbal"),
        ("--fault fog", "--fault fog: want one of black, dark, low-contrast,"),
        ("--method orb", "--method orb: want one of joint, open3d"),
        ("--camera-errors 3", "--camera-errors 3: want none, default or a factor of 0 to 2"),
        ("--scene /nowhere", "/nowhere: no such scene"),
        ("--json /nowhere/x.json", "--json /nowhere/x.json: no such folder /nowhere"),
        ("--cache /proc/x", "--cache /proc/x"),
    ],
)
def test_invalid_options_are_a_one_line_error(words: str, line: str) -> None:
    code, out, errors = bench(*words.split())
    assert code != 0
    assert out == ""
    assert errors.strip().splitlines()[-1].startswith(f"uav-recon: {line}")
    assert len(errors.strip().splitlines()) == 1


def test_the_command_line_offers_every_tracker() -> None:
    assert tuple(METHODS) == TRACKERS


@pytest.mark.nightly
@pytest.mark.slow
def test_the_baseline_follows_a_short_path(tmp_path: Path) -> None:
    written = tmp_path / "slam.json"
    arguments = ("--length", "2", "--camera-errors", "none", "--method", "open3d", "--json", str(written))
    code, _, errors = bench(*arguments)
    assert code == 0, errors
    (row,) = json.loads(written.read_text())["sequences"]
    assert 2.0 < row["length_m"] < 5.0
    assert row["ate_cm"] < 50.0
    assert row["lost"] < 0.5
