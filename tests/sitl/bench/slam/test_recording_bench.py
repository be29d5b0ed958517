"""Trackers on recordings: errors by hand, pairs by stamps, lost time, a gyro from the reference, and bad input."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from recording_folders import K, world_from_optical, write_seven_scenes, write_tum
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from sitl.bench.slam import frame_trackers, recording_bench
from sitl.bench.slam.recording_bench import RecordedSequence, figures, reference_gyro, track
from uav_recon.cli.main import app
from uav_recon.sensors.recordings.detection import ReadOptions
from uav_recon.sensors.recordings.recording import LEVEL_MOUNT
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose, StampedPose

FRAMES = 45
OPTIONS = ReadOptions()


class FromReference:
    """Tracker that gives the reference, moved, a centimetre higher at every second frame, and nothing of some frames."""

    def __init__(self, lost: range = range(0)) -> None:
        self.samples: list[ImuSample] = []
        self.brightest = 0
        self._lost = lost

    def add_imu(self, samples: list[ImuSample]) -> None:
        self.samples += samples

    def track(self, frame: Frame, body_from_depth: Pose) -> StampedPose | None:
        self.brightest = max(self.brightest, int(frame.rgb.max()))
        if frame.sequence in self._lost:
            return None
        moved = Pose.from_yaw(1.0, np.array([3.0, 0.0, 0.0])) @ Pose.from_matrix(world_from_optical(frame.sequence))
        place_m = moved.translation_m + np.array([0.0, 0.0, 0.01 * (frame.sequence % 2)])
        return StampedPose(frame.stamp_s, Pose(moved.quat_wxyz, place_m) @ LEVEL_MOUNT.inverse(), np.zeros(3))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_seven_scenes(tmp_path / "scene", FRAMES)
    return tmp_path / "scene"


def bench(*arguments: str) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, ["bench", "slam", *arguments])
    return done.exit_code, done.stdout, done.stderr


def test_errors_are_those_of_the_known_offset(folder: Path) -> None:
    sequence = RecordedSequence.of(folder, OPTIONS, gyro=False)
    found = figures(track(FromReference(), sequence), sequence)
    assert found["frames"] == found["paired"] == FRAMES
    assert found["ate_cm"] == pytest.approx(0.5, rel=0.02), "half a centimetre to each side of the mean"
    assert found["ate_max_cm"] == pytest.approx(0.5, rel=0.1)
    assert found["rpe_cm"] == pytest.approx(0.0, abs=1e-6), "frames a second apart have the same offset"
    assert found["length_m"] == pytest.approx(0.1 * (FRAMES - 1))
    assert found["scale"] == pytest.approx(1.0, abs=1e-3)
    assert found["lost_s"] == found["first_pose_s"] == 0.0


def test_time_without_a_pose_counts_after_the_first_one(folder: Path) -> None:
    sequence = RecordedSequence.of(folder, OPTIONS, gyro=False)
    late = figures(track(FromReference(range(9)), sequence), sequence)
    assert late["first_pose_s"] == pytest.approx(0.3)
    assert late["lost_s"] == 0.0
    gap = figures(track(FromReference(range(10, 16)), sequence), sequence)
    assert gap["lost_s"] == pytest.approx(7 / 30 - 0.1)
    assert gap["paired"] == FRAMES - 6
    end = figures(track(FromReference(range(30, FRAMES)), sequence), sequence)
    assert end["lost_s"] == pytest.approx(15 / 30 - 0.1)
    never = figures(track(FromReference(range(FRAMES)), sequence), sequence)
    assert (never["ate_cm"], never["first_pose_s"]) == (None, None)
    assert never["lost_s"] == pytest.approx((FRAMES - 1) / 30)


def test_poses_without_a_reference_near_them_are_not_judged(folder: Path) -> None:
    for number in range(20, FRAMES):
        (folder / f"frame-{number:06d}.pose.txt").unlink()
    sequence = RecordedSequence.of(folder, OPTIONS, gyro=False)
    assert figures(track(FromReference(), sequence), sequence)["paired"] == 20
    for file in folder.glob("*.pose.txt"):
        file.unlink()
    sequence = RecordedSequence.of(folder, OPTIONS, gyro=False)
    found = figures(track(FromReference(), sequence), sequence)
    assert (found["paired"], found["ate_cm"], found["scale"], found["lost_s"]) == (0, None, None, 0.0)


def test_a_made_gyro_turns_as_the_reference_but_for_noise_and_bias() -> None:
    stamp_s = np.arange(0.0, 6.0, 0.01)
    vectors = np.column_stack((0.3 * np.sin(stamp_s), 0.2 * np.cos(2 * stamp_s), 0.5 * stamp_s))
    poses: FloatArray = np.tile(np.eye(4), (len(stamp_s), 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(vectors).as_matrix()
    samples = reference_gyro(stamp_s, poses)
    at_s, rate = np.array([s.stamp_s for s in samples]), np.array([s.gyro_radps for s in samples])
    assert np.diff(at_s) == pytest.approx(1.0 / recording_bench.GYRO_HZ)
    assert all(math.isnan(sample.specific_force_mps2[0]) for sample in samples)
    dense = Rotation.from_rotvec(
        np.column_stack([np.interp(np.append(at_s - 0.005, at_s[-1] + 0.005), stamp_s, column) for column in vectors.T])
    )
    true = (dense[:-1].inv() * dense[1:]).as_rotvec()[:-1] * 200.0
    off = rate[:-1] - true
    assert np.abs(off.mean(axis=0)).max() < 1.5 * recording_bench.GYRO_BIAS_RADPS
    density = off.std(axis=0) / math.sqrt(recording_bench.GYRO_HZ)
    assert np.abs(density / recording_bench.GYRO_DENSITY - 1.0).max() < 0.5
    assert reference_gyro(stamp_s, poses)[7].gyro_radps.tolist() == samples[7].gyro_radps.tolist()


def test_the_tracker_gets_the_samples_that_came_before_each_frame(folder: Path) -> None:
    sequence = RecordedSequence.of(folder, OPTIONS, gyro=True)
    tracker = FromReference()
    track(tracker, sequence)
    assert 0.8 * 200 * FRAMES / 30 < len(tracker.samples) <= len(sequence.imu)
    assert tracker.samples[-1].stamp_s < (FRAMES - 1) / 30


def test_the_command_writes_what_it_prints(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_tum(tmp_path / "rgbd_dataset_freiburg1_small", 40)
    monkeypatch.setitem(frame_trackers.METHODS, "joint", FromReference)
    written = tmp_path / "recordings.json"
    both = ("--recording", str(folder), "--recording", str(tmp_path / "rgbd_dataset_freiburg1_small"))
    code, out, errors = bench(*both, "--method", "joint", "--gyro", "reference", "--json", str(written))
    assert code == 0, errors
    rows = json.loads(written.read_text())["recordings"]
    assert [row["recording"] for row in rows] == ["scene", "rgbd_dataset_freiburg1_small"]
    assert rows[0]["ate_cm"] == pytest.approx(0.5, rel=0.02)
    assert rows[0]["gyro"] == "reference"
    assert "GYRO MADE FROM THE REFERENCE" in out
    assert "0.50" in out


def test_a_black_image_is_what_the_tracker_gets(folder: Path) -> None:
    sequence, tracker = RecordedSequence.of(folder, OPTIONS, gyro=False), FromReference()
    track(tracker, sequence, black=True)
    assert tracker.brightest == 0
    track(tracker, sequence)
    assert tracker.brightest == 200


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--recording", "nowhere"), "nowhere"),
        (("--recording", "FOLDER", "--fault", "covered"), "--fault covered: want black"),
        (("--recording", "FOLDER", "--scene", "built-in"), "--scene and --recording"),
        (("--recording", "FOLDER", "--gyro", "perfect"), "--gyro perfect: want one of none, reference"),
        (("--recording", "FOLDER", "--intrinsics", "1,2"), "--intrinsics"),
        (("--gyro", "reference"), "want --recording"),
    ],
)
def test_bad_input_is_one_line(folder: Path, arguments: tuple[str, ...], words: str) -> None:
    code, _, errors = bench(*(str(folder) if word == "FOLDER" else word for word in arguments))
    assert code != 0
    assert words in errors
    assert "Traceback" not in errors


def test_a_folder_without_reference_makes_no_gyro(folder: Path) -> None:
    for file in folder.glob("*.pose.txt"):
        file.unlink()
    code, _, errors = bench("--recording", str(folder), "--gyro", "reference")
    assert code != 0
    assert "has 0 reference poses" in errors


def test_images_that_cannot_be_read_are_named(folder: Path) -> None:
    for image in folder.glob("*.depth.png"):
        image.write_bytes(b"no image")
    code, _, errors = bench("--recording", str(folder), "--method", "joint", "--intrinsics", ",".join(map(str, K)))
    assert code != 0
    assert "frame-000000.depth.png: is no known image" in errors
