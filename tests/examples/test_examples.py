from __future__ import annotations

import ast
import csv
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from uav_recon.sensors.stream_camera import StreamCamera, StreamPoses
from uav_recon.sensors.stream_format import StreamReader

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "examples"
SCRIPTS = sorted(path.name for path in FOLDER.glob("*.py"))
MAX_LINES = 65


def is_map(path: Path) -> None:
    """Free in the room, occupied at the walls, unknown outside and in the cabinet."""
    grey = np.asarray(Image.open(path).convert("L"))[::-1][::10, ::10].T
    assert (grey[6:30, 6:20] == 255).all()
    assert (grey == 0).sum() > 100
    assert grey[0, 0] == grey[41, 36] == 128
    assert grey[41, 10] == 255


def is_image(path: Path) -> None:
    image = np.asarray(Image.open(path).convert("L"))
    assert image.shape == (600, 800)
    assert image.std() > 5


def is_room(path: Path) -> None:
    mesh = trimesh.load(path)
    np.testing.assert_allclose(mesh.bounds, [[0.0, 0.0, 0.0], [4.0, 3.0, 2.5]], atol=0.15)
    assert np.asarray(mesh.visual.vertex_colors)[:, :3].std() > 20


def is_stream(path: Path) -> None:
    camera, poses = StreamCamera(path), StreamPoses(path)
    frame = camera.poll()
    assert frame is not None
    assert frame.sequence == 60
    assert float(np.nanmedian(frame.depth_m)) == pytest.approx(2.41, abs=0.02)
    assert len(camera.imu()) == 60
    (*_, newest) = poses.poses()
    assert newest.odom_from_body.translation_m[0] == pytest.approx(0.59, abs=0.01)
    assert newest.stamp_s == frame.stamp_s
    assert StreamReader(path).header.depth.fx == 223.4


def is_odometry(path: Path) -> None:
    rows = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
    assert len(rows) > 20
    stamps_s = [float(row["stamp_s"]) for row in rows]
    assert stamps_s == sorted(set(stamps_s))
    assert all(float(row["x_m"]) ** 2 + float(row["y_m"]) ** 2 == pytest.approx(1.0) for row in rows)


CHECKS: dict[str, tuple[str, Callable[[Path], None]]] = {
    "map_from_rgbd.py": ("occupancy.png", is_map),
    "mesh_from_keyframes.py": ("room.ply", is_room),
    "plan_next_views.py": ("views.png", is_image),
    "read_channels.py": ("odom.csv", is_odometry),
    "write_camera_stream.py": ("camera.stream", is_stream),
}


def run(name: str, folder: Path, *arguments: str) -> str:
    child = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-W", "error", str(FOLDER / name), *arguments],
        cwd=folder,
        env=child,
        text=True,
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("name", SCRIPTS)
def test_each_example_runs_and_writes_its_file(name: str, tmp_path: Path) -> None:
    default, is_right = CHECKS[name]
    text = run(name, tmp_path)
    assert default in text
    is_right(tmp_path / default)
    assert [path.name for path in tmp_path.iterdir()] == [default]


@pytest.mark.nightly
@pytest.mark.slow
def test_the_planner_example_explores_the_hidden_half(tmp_path: Path) -> None:
    text = run("plan_next_views.py", tmp_path, "other.png")
    (*_, last, reason, _) = text.splitlines()
    assert float(last.split(",")[1].split()[0]) > 55.0  # of 60 m3, half of which lie behind the wall
    assert "frontiers left" in reason
    assert (tmp_path / "other.png").exists()


@pytest.mark.slow
def test_the_channel_example_reads_the_folder_that_it_is_given(tmp_path: Path) -> None:
    runtime = tmp_path / "run"
    assert "wrote x.csv: 0 of 0 odometry values; map absent" in run("read_channels.py", tmp_path, "x.csv", str(runtime))
    assert len((tmp_path / "x.csv").read_text(encoding="utf-8").splitlines()) == 1


@pytest.mark.parametrize("name", SCRIPTS)
def test_each_example_is_small_and_stands_alone(name: str) -> None:
    text = (FOLDER / name).read_text(encoding="utf-8")
    assert len(text.splitlines()) <= MAX_LINES
    imported = {
        alias.name if isinstance(node, ast.Import) else str(node.module)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for alias in node.names
    }
    assert not {one.split(".")[0] for one in imported} & {"sitl", "tests", *(Path(script).stem for script in SCRIPTS)}


def test_the_readme_lists_each_example() -> None:
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    for name in SCRIPTS:
        assert f"| [{name}]({name}) |" in text
        assert CHECKS[name][0] in text
