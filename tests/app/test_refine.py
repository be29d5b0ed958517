"""`uav-recon refine` as a user runs it, on a flight through the box room that is made here."""

from __future__ import annotations

import io
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from box_room import BASELINE_M, HIGH, LOW, NOISE_PX, WALL_RGB, tour
from typer.testing import CliRunner

from uav_recon import config as configuration
from uav_recon.app import refine
from uav_recon.app.processes import claim_file
from uav_recon.cli.main import app
from uav_recon.mapping.keyframe_store import KeyframeFolder
from uav_recon.mapping.neural.sdf_torch.checkpoint import BEFORE, LAST
from uav_recon.recording.mesh_file import load_mesh
from uav_recon.types.frames import ByteArray

FLOWN = Path(__file__).parents[2] / "systemd" / "config.toml"
SMALL = ("--steps", "150", "--voxel", "0.05", "--device", "cpu")


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    torch.set_num_threads(1)
    monkeypatch.setitem(refine.RAYS, "cpu", 256)


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    flight = tmp_path_factory.mktemp("flown")
    tree = configuration.load(FLOWN).model_dump(mode="json", exclude_none=True)
    low, high = LOW - 0.3, HIGH + 0.3  # the take-off position is a corner of the room, and the fence has its inset around it
    tree["safety"] |= {"fence_min_m": low.tolist(), "fence_max_m": high.tolist(), "fence_inset_m": 0.2}
    tree["camera"] |= {"depth_noise_px": NOISE_PX, "baseline_m": BASELINE_M}
    configuration.save(configuration.parse(tree, "test"), flight / "config.toml")
    keyframes = KeyframeFolder(flight / "keyframes")
    for view in tour(8):
        keyframes.save(view)
    return flight


@pytest.fixture
def flight(flown: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(flown, tmp_path / "flight"))


def call(flight: Path, *arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["refine", str(flight), *(arguments or SMALL)])
    return done.exit_code, done.stderr


def test_writes_a_watertight_ply_a_textured_glb_and_images(flight: Path) -> None:
    code, said = call(flight)
    assert code == 0, said
    folder = flight / "refined"
    assert trimesh.load(folder / "mesh.ply").is_watertight
    scene = trimesh.load(folder / "mesh.glb")
    assert max(scene.geometry["observed"].visual.material.baseColorTexture.size) > 60
    assert len(scene.geometry["unseen"].faces) > 100
    model = load_mesh(folder)
    assert model is not None
    assert len(model.faces) == len(scene.geometry["observed"].faces)
    assert {path.name for path in folder.glob("*.png")} == {"mesh_colour.png", "mesh_uncertainty.png", "mesh_top.png"}
    assert f"{folder / 'mesh.ply'}, mesh.glb:" in said.replace("\n", "")


@pytest.mark.nightly
def test_observed_surface_has_the_colours_of_the_images(flight: Path) -> None:
    """A field needs minutes to learn colours.

    In the PLY and in the texture they are correct at once, wherever a ray met the wall.
    """
    assert call(flight)[0] == 0
    model = load_mesh(flight / "refined")
    assert model is not None
    assert share_in_wall_colours(model.rgb[np.unique(model.faces)]) > 0.2
    seen = trimesh.load(flight / "refined" / "mesh.glb").geometry["observed"]
    assert share_in_wall_colours(np.asarray(seen.visual.material.baseColorTexture)) > 0.05


def share_in_wall_colours(rgb: ByteArray) -> float:
    """Return the share of pixels or vertices (..., 3) that have the colour of a wall."""
    error = np.abs(rgb.reshape(-1, 1, 3).astype(int) - WALL_RGB).max(axis=2).min(axis=1)
    return float(np.mean(error < 10))


@pytest.mark.nightly
def test_a_second_call_resumes_and_one_with_other_options_is_refused(flight: Path) -> None:
    assert call(flight)[0] == 0
    _, said = call(flight)
    assert "continuing after 150 of 150 steps" in said
    code, said = call(flight, "--steps", "151", "--voxel", "0.05", "--device", "cpu")
    assert code == 2
    assert said.splitlines()[-1].endswith("steps 150 there, 151 here; move the folder away to start again")


def test_damaged_checkpoints_are_named_and_training_starts_again(flight: Path) -> None:
    (flight / "refined").mkdir()
    for name in (LAST, BEFORE):
        (flight / "refined" / name).write_bytes(b"broken")
    code, said = call(flight)
    assert code == 0
    assert said.count("damaged, left aside") == 2
    assert "starting from the beginning" in said
    assert (flight / "refined" / "mesh.ply").exists()


def test_a_damaged_view_is_left_out(flight: Path) -> None:
    (flight / "keyframes" / "0003_depth.png").write_bytes(b"torn")
    code, said = call(flight)
    assert code == 0
    assert "images of keyframe 3 are missing or damaged" in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--voxel", "0.5"), "--voxel 0.5: want 0.005 to 0.05"),
        (("--voxel", "nan"), "--voxel nan: want 0.005 to 0.05"),
        (("--steps", "0"), "--steps 0: want 1 to 1000000"),
        (("--save-every", "0"), "--save-every 0: want 1 to 3600"),
        (("--device", "tpu"), "--device tpu: want auto, cpu, cuda"),
    ],
)
def test_an_invalid_option_is_a_one_line_error_with_the_range(flight: Path, arguments: tuple[str, ...], words: str) -> None:
    assert call(flight, *arguments) == (2, f"uav-recon: {words}\n")


@pytest.mark.parametrize(("asked", "memory_gb", "want"), [
    ("8", 7.6, "1 to 7; each may use 1 GB of memory"),
    ("100", 7.6, "1 to 7; each may use 1 GB of memory"),
    ("0", 128.0, "1 to 64"),
    ("65", 128.0, "1 to 64"),
])  # fmt: skip
def test_more_processes_than_fit_in_memory_are_refused(
    flight: Path, monkeypatch: pytest.MonkeyPatch, asked: str, memory_gb: float, want: str
) -> None:
    monkeypatch.setattr("uav_recon.app.refine.memory_gb", lambda: memory_gb)
    assert call(flight, "--processes", asked) == (2, f"uav-recon: --processes {asked}: want {want}\n")


def test_a_folder_without_a_flight_is_a_one_line_error(tmp_path: Path) -> None:
    assert call(tmp_path / "none") == (2, f"uav-recon: {tmp_path / 'none'}: no such flight folder\n")
    code, said = call(tmp_path)
    assert code == 2
    assert "has no keyframes" in said
    assert len(said.splitlines()) == 1


def test_unusable_keyframes_are_an_error(flight: Path) -> None:
    for path in (flight / "keyframes").glob("*_depth.png"):
        path.write_bytes(b"torn")
    code, said = call(flight)
    assert code == 1
    assert "none of its 8 keyframes can be used" in said


def test_a_second_refinement_of_a_flight_is_refused(flight: Path) -> None:
    (flight / "refined").mkdir()
    lock = claim_file(flight / "refined" / refine.LOCK_FILE, "held by this test")
    assert call(flight) == (75, f"uav-recon: another refinement of {flight} is running\n")
    os.close(lock)


def start(flight: Path, *arguments: str) -> subprocess.Popen[str]:
    command = [
        sys.executable,
        "-m",
        "uav_recon",
        "refine",
        str(flight),
        *arguments,
        "--device",
        "cpu",
        "--voxel",
        "0.05",
    ]
    threads = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | threads)


def wait_until(condition: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    while not condition():
        assert process.poll() is None, process.communicate()[1]
        threading.Event().wait(0.02)


@pytest.mark.nightly
@pytest.mark.slow
def test_a_kill_loses_little_progress_and_ctrl_c_none(flight: Path) -> None:
    last, endless = flight / "refined" / LAST, ("--steps", "100000", "--save-every", "1")
    killed = start(flight, *endless)
    wait_until(last.exists, killed)
    killed.kill()
    killed.communicate()
    written_ns = last.stat().st_mtime_ns
    again = start(flight, *endless)
    wait_until(lambda: last.exists() and last.stat().st_mtime_ns > written_ns, again)
    again.send_signal(signal.SIGINT)
    _, said = again.communicate(timeout=60)
    assert again.returncode == 0, said
    assert "continuing after " in said
    assert "the same command continues from there" in said


@pytest.mark.nightly
@pytest.mark.slow
def test_two_processes_learn_one_field(flight: Path) -> None:
    """gloo between two processes replaces nccl between GPUs; torchrun starts both."""
    process = start(flight, "--steps", "40", "--processes", "2")
    _, said = process.communicate(timeout=200)
    assert process.returncode == 0, said
    assert trimesh.load(flight / "refined" / "mesh.ply").is_watertight
    held = io.BytesIO((flight / "refined" / LAST).read_bytes()[32:])
    field = torch.load(held, weights_only=True)["state"]
    assert int(field["steps"]) == 40
    assert np.isfinite(field["weights"].numpy()).all()
