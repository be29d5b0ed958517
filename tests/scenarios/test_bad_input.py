"""Bad input gives one line that names the cause, the right exit code, no traceback and nothing left running."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

pytestmark = pytest.mark.slow


def uav_recon(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "uav_recon", *arguments], capture_output=True, text=True, timeout=120, check=False
    )


def room(path: Path, *, roof: bool = True) -> Path:
    """A box of 6 x 4 x 2.5 m seen from inside, with a pillar at (4, 2)."""
    box = trimesh.creation.box((6.0, 4.0, 2.5)).apply_translation((3.0, 2.0, 1.25))
    if not roof:
        box.update_faces(box.triangles_center[:, 2] < 2.4)
    pillar = trimesh.creation.box((0.5, 0.5, 2.5)).apply_translation((4.0, 2.0, 1.25))
    whole = trimesh.util.concatenate([box.subdivide_to_size(0.3), pillar.subdivide_to_size(0.2)])
    whole.visual.vertex_colors = np.full((len(whole.vertices), 4), 200, np.uint8)
    whole.export(path)
    return path


def says_one_line(done: subprocess.CompletedProcess[str], code: int, *words: str) -> None:
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr + done.stdout
    assert len(lines) == 1, done.stderr
    for word in words:
        assert word in lines[0]


def test_a_missing_scene(tmp_path: Path) -> None:
    says_one_line(uav_recon("sim", "--scene", str(tmp_path / "nowhere.ply"), "--start", "1,1,0,0"), 2, "nowhere.ply")


def test_a_mesh_without_a_start(tmp_path: Path) -> None:
    says_one_line(uav_recon("sim", "--scene", str(room(tmp_path / "room.ply"))), 2, "start")


def test_an_open_scene_without_a_fence(tmp_path: Path) -> None:
    scene = room(tmp_path / "open.ply", roof=False)
    says_one_line(uav_recon("sim", "--scene", str(scene), "--start", "1.5,2,0,0"), 2, "fence")


def test_a_start_inside_an_obstacle(tmp_path: Path) -> None:
    scene = room(tmp_path / "room.ply")
    says_one_line(uav_recon("sim", "--scene", str(scene), "--start", "4.0,2.3,0,0"), 2, "start")


@pytest.mark.parametrize(
    ("option", "value"),
    [("--mount", "fixed:80"), ("--depth-noise", "loud"), ("--start", "1,2"), ("--fence", "0,0,0,1,1,x"), ("--variant", "best")],
)
def test_an_option_out_of_range_names_what_is_allowed(option: str, value: str) -> None:
    says_one_line(uav_recon("sim", option, value), 2, value, "want")


def test_an_output_folder_that_cannot_be_written() -> None:
    says_one_line(uav_recon("sim", "--out", "/dev/null/flight"), 2, "/dev/null/flight")


def test_a_folder_that_holds_a_flight_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "timeline.jsonl").write_text("")
    says_one_line(uav_recon("sim", "--out", str(tmp_path)), 2, "already contains timeline.jsonl; name another folder")


def test_a_port_in_use(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        says_one_line(uav_recon("sim", "--port", str(port), "--out", str(tmp_path / "f")), 1, str(port), "in use")


@pytest.mark.parametrize("process", ["pilot", "perception", "mission"])
def test_an_unknown_config_key_is_exit_78(tmp_path: Path, process: str) -> None:
    config = tmp_path / "config.toml"
    config.write_text("[safety]\nmax_sped_mps = 3\n")
    says_one_line(uav_recon(process, "--config", str(config)), 78, str(config), "safety")


def test_a_missing_config_is_exit_78(tmp_path: Path) -> None:
    says_one_line(uav_recon("pilot", "--config", str(tmp_path / "none.toml")), 78, "none.toml")


def test_a_review_of_nothing(tmp_path: Path) -> None:
    says_one_line(uav_recon("review", str(tmp_path / "none")), 2, "none")


def test_help_teaches() -> None:
    done = uav_recon("sim", "--help")
    assert done.returncode == 0
    for word in ("--scene", "--views", "--lockstep", "Ctrl-C"):
        assert word in done.stdout
