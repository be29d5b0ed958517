from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh
from box_room import BASELINE_M, HIGH, LOW, NOISE_PX, distance_to_walls, look, tour

from uav_recon.config import MapperConfig
from uav_recon.mapping.keyframes import KeyframeFolder
from uav_recon.mapping.neural.trainer import Trainer
from uav_recon.mapping.neural.worker import RESTARTS, InlineMapper, ProcessMapper

CONFIG = MapperConfig(steps_per_view=10, idle_steps_hz=5.0, polish_steps=20, mesh_voxel_m=0.05)
PATIENCE_S = 120.0


def _wait(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    pause = __import__("threading").Event()
    while not condition():
        if time.monotonic() > deadline:
            raise AssertionError(f"{what} did not happen within {PATIENCE_S} s")
        pause.wait(0.01)


@pytest.fixture
def mapper(tmp_path: Path) -> Iterator[ProcessMapper]:
    mapper = ProcessMapper(CONFIG, LOW, HIGH, NOISE_PX, BASELINE_M, tmp_path)
    yield mapper
    mapper.close()


def _revision(mapper: ProcessMapper) -> int:
    surface = mapper.surface()
    return 0 if surface is None else surface.revision


def test_inline_learns_at_once_saves_and_meshes(tmp_path: Path) -> None:
    keyframes = KeyframeFolder(tmp_path / "keyframes")
    mapper = InlineMapper(Trainer(CONFIG, LOW, HIGH, NOISE_PX, BASELINE_M), CONFIG, keyframes)
    assert mapper.surface() is None
    for view in tour(4):
        assert mapper.add(view)
    surface = mapper.surface()
    assert surface is not None
    assert len(surface.position_world) > 1000
    assert mapper.surface() is surface
    assert len(keyframes) == 4
    assert mapper.alive()
    mapper.finish(tmp_path)
    assert len(trimesh.load(tmp_path / "mesh.ply").faces) > 1000


def test_process_learns_outlives_a_kill_and_meshes(mapper: ProcessMapper, tmp_path: Path) -> None:
    assert mapper.alive()
    views = tour(6)
    for view in views[:3]:
        assert mapper.add(view)
    assert not mapper.add(look((9.0, 9.0, 1.0), 0.0))
    _wait(mapper.ready, "ready")
    _wait(lambda: _revision(mapper) > 0, "a first surface")
    first = mapper.pid
    os.kill(first, signal.SIGKILL)
    _wait(lambda: not mapper.alive(), "noticing the death")
    assert mapper.surface() is not None
    assert mapper.add(views[3])
    _wait(mapper.ready, "the second child")
    assert mapper.alive()
    assert mapper.pid != first
    before = _revision(mapper)
    for view in views[4:]:
        assert mapper.add(view)
    _wait(lambda: _revision(mapper) > before, "a surface of the second child")
    mapper.finish(tmp_path)
    assert not mapper.alive()
    assert not mapper.add(views[0])
    assert len(KeyframeFolder(tmp_path / "keyframes")) == 6
    mesh = trimesh.load(tmp_path / "mesh.ply", process=False)
    assert len(mesh.faces) > 1000
    assert distance_to_walls(np.asarray(mesh.vertices)).mean() < 0.02
    assert np.asarray(mesh.metadata["_ply_raw"]["vertex"]["data"]["uncertainty"]).min() > 0
    with pytest.raises(ProcessLookupError):
        os.kill(mapper.pid, 0)


def test_a_mapper_that_keeps_dying_is_given_up(mapper: ProcessMapper, tmp_path: Path) -> None:
    for n in range(RESTARTS + 1):
        pid = mapper.pid
        os.kill(pid, signal.SIGKILL)
        if n < RESTARTS:
            _wait(lambda old=pid: mapper.pid != old, "a restart")  # type: ignore[misc]
    _wait(lambda: not mapper.add(look((1.5, 1.2, 1.0), 0.0)), "giving up")
    assert not mapper.alive()
    mapper.finish(tmp_path)
    assert not (tmp_path / "mesh.ply").exists()


def test_the_child_ends_with_its_parent(tmp_path: Path) -> None:
    program = (
        "import numpy as np, sys, pathlib\n"
        "from uav_recon.config import MapperConfig\n"
        "from uav_recon.mapping.neural.worker import ProcessMapper\n"
        "m = ProcessMapper(MapperConfig(), np.zeros(3), np.ones(3), 0.08, 0.05, pathlib.Path(sys.argv[1]))\n"
        "print(m.pid, flush=True)\n"
        "sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        assert _runs(child)
        os.kill(child, signal.SIGINT)  # a terminal's Ctrl-C ends the flight, not the mapper
        parent.kill()
    _wait(lambda: not _runs(child), "the child's end")


def _runs(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"
