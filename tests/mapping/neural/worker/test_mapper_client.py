from __future__ import annotations

import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh
from box_room import BASELINE_M, HIGH, LOW, NOISE_PX, bent, correction, distance_to_walls, look, tour

from uav_recon.config import MapperConfig
from uav_recon.mapping.keyframe_store import KeyframeFolder
from uav_recon.mapping.neural.keyframes.keyframe_validation import RejectReason
from uav_recon.mapping.neural.worker.checkpoint import EVERY_VIEWS
from uav_recon.mapping.neural.worker.child_watchdog import CHECK_PERIOD_S, IDLE_TIMEOUT_S
from uav_recon.mapping.neural.worker.mapper_client import RESTARTS, ProcessMapper
from uav_recon.mapping.neural.worker.mapper_process import CHECKPOINT, LOG_FILE, NICENESS, OOM_SCORE_ADJ

CONFIG = MapperConfig(steps_per_view=10, idle_steps_hz=5.0, polish_steps=20, mesh_voxel_m=0.05)
PATIENCE_S = 120.0


def _wait(condition: Callable[[], bool], what: str, patience_s: float = PATIENCE_S, every_s: float = 0.01) -> None:
    deadline = time.monotonic() + patience_s
    pause = __import__("threading").Event()
    while not condition():
        if time.monotonic() > deadline:
            raise AssertionError(f"{what} did not happen within {patience_s} s")
        pause.wait(every_s)


@pytest.fixture
def mapper(tmp_path: Path) -> Iterator[ProcessMapper]:
    mapper = ProcessMapper(CONFIG, LOW, HIGH, NOISE_PX, BASELINE_M, tmp_path)
    yield mapper
    mapper.close()


def _revision(mapper: ProcessMapper) -> int:
    surface = mapper.surface()
    return 0 if surface is None else surface.revision


@pytest.mark.nightly
def test_a_child_that_hangs_is_replaced_while_views_keep_coming(mapper: ProcessMapper) -> None:
    for view in tour(3):
        assert mapper.add(view)
    _wait(mapper.ready, "ready")
    hung, another = mapper.pid, tour(6)[4]
    os.kill(hung, signal.SIGSTOP)
    _wait(
        lambda: mapper.add(another) and mapper.pid != hung, "another child", IDLE_TIMEOUT_S + 20.0, every_s=0.6 * CHECK_PERIOD_S
    )
    _wait(mapper.ready, "the second child")
    before = _revision(mapper)
    assert mapper.add(tour(6)[5])
    _wait(lambda: _revision(mapper) > before, "a surface of the second child")


def test_the_process_learns_survives_a_kill_and_meshes(mapper: ProcessMapper, tmp_path: Path) -> None:
    assert mapper.alive()
    views = tour(6)
    for view in views[:3]:
        assert mapper.add(view)
    assert not mapper.add(look((9.0, 9.0, 1.0), 0.0))
    _wait(mapper.ready, "ready")
    _wait(lambda: _revision(mapper) > 0, "a first surface")
    first = mapper.pid
    assert os.getpriority(os.PRIO_PROCESS, first) == min(os.getpriority(os.PRIO_PROCESS, 0) + NICENESS, 19)
    group = Path(f"/proc/{first}/autogroup")
    assert not group.exists() or group.read_text().endswith(f"nice {NICENESS}\n")
    assert int(Path(f"/proc/{first}/oom_score_adj").read_text()) == OOM_SCORE_ADJ, "the kernel takes it before its mission"
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


def _cpu_s(pid: int) -> float:
    """Return the CPU time of a process in seconds.

    Unlike wall time, it does not depend on the load of the machine.
    """
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _kill(mapper: ProcessMapper) -> None:
    pid = mapper.pid
    os.kill(pid, signal.SIGKILL)
    _wait(lambda: mapper.pid != pid, "the next child")
    _wait(mapper.ready, "its return")


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.timeout(900)
def test_killed_after_120_views_it_is_back_within_10_s_from_its_checkpoint(tmp_path: Path) -> None:
    config = MapperConfig(steps_per_view=40, idle_steps_hz=0.0)
    mapper = ProcessMapper(config, LOW, HIGH, NOISE_PX, BASELINE_M, tmp_path)
    try:
        _wait(mapper.ready, "ready")
        start_s = _cpu_s(mapper.pid)
        views = tour(120, NOISE_PX)
        for view in views[:-3]:
            _wait(lambda view=view: mapper.add(view), "a place in the queue")  # type: ignore[misc]
        _wait(lambda: _kept(tmp_path) >= 112, "a checkpoint with nearly all of them", 600.0)
        all_s = _cpu_s(mapper.pid) - start_s
        before = _revision(mapper)
        for view in views[-3:]:
            assert mapper.add(view)
        _kill(mapper)
        back_s = _cpu_s(mapper.pid)
        surface = mapper.surface()
        assert surface is not None
        assert surface.revision > before
        assert _went_on(tmp_path)[0] >= 112
        assert back_s < 10.0
        assert all_s > 15.0, f"{all_s:.1f} s: too few views to show the difference"
        print(f"learning {all_s:.1f} s, back {back_s:.1f} s of the processor")
    finally:
        mapper.close()


def test_a_child_resumes_from_its_checkpoint_and_reports_a_damaged_one(tmp_path: Path) -> None:
    config = MapperConfig(steps_per_view=2, idle_steps_hz=0.0)
    mapper = ProcessMapper(config, LOW, HIGH, NOISE_PX, BASELINE_M, tmp_path)
    state = tmp_path / CHECKPOINT / "state"
    try:
        for view in tour(EVERY_VIEWS + 2):
            assert mapper.add(view)
        _wait(state.exists, "a checkpoint")
        _kill(mapper)
        assert _went_on(tmp_path) == [EVERY_VIEWS]
        os.truncate(state, 1000)
        _kill(mapper)
        assert f"{state}: damaged; learning all {EVERY_VIEWS + 2} keyframes again" in (tmp_path / LOG_FILE).read_text()
        assert mapper.alive()
    finally:
        mapper.close()
    assert not (tmp_path / CHECKPOINT).exists()


@pytest.mark.parametrize("killed", [False, True])
def test_on_a_new_map_epoch_the_child_or_its_successor_relearns_the_map_from_the_views(
    killed: bool, mapper: ProcessMapper, tmp_path: Path
) -> None:
    views = tour(EVERY_VIEWS, NOISE_PX)
    for view in bent(views):
        assert mapper.add(view)
    _wait(lambda: _revision(mapper) > 0 and (tmp_path / CHECKPOINT / "state").exists(), "a checkpoint of the bent map")
    if killed:
        os.kill(mapper.pid, signal.SIGKILL)
    mapper.repose(correction(views[2:], 1))
    assert mapper.surface() is None  # the surface was of the old map
    assert not mapper.add(views[0])
    _wait(lambda: _revision(mapper) > 0, "a surface of the new map")
    assert mapper.refusals() == {RejectReason.EPOCH: 1, RejectReason.UNPLACED: 2}
    surface = mapper.surface()
    assert surface is not None
    assert surface.map_epoch == 1
    assert distance_to_walls(surface.position_world).mean() < 0.02
    assert mapper.add(dataclasses.replace(views[0], map_epoch=1))
    mapper.finish(tmp_path)
    assert len(KeyframeFolder(tmp_path / "keyframes")) == EVERY_VIEWS + 1
    assert distance_to_walls(np.asarray(trimesh.load(tmp_path / "mesh.ply").vertices)).mean() < 0.02


def _kept(folder: Path) -> int:
    """Return the number of keyframes in the checkpoint."""
    try:
        return int(json.loads((folder / CHECKPOINT / "state").read_bytes().split(b"\n", 2)[1])["learned"])
    except FileNotFoundError:
        return 0


def _went_on(folder: Path) -> list[int]:
    """Return the numbers of keyframes in the checkpoints from which children resumed."""
    return [int(n) for n in re.findall(r"went on from a checkpoint with (\d+)", (folder / LOG_FILE).read_text())]


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
        "from uav_recon.mapping.neural.worker.mapper_client import ProcessMapper\n"
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
        os.kill(child, signal.SIGINT)  # Ctrl-C in a terminal ends the flight, not the mapper
        parent.kill()
    _wait(lambda: not _runs(child), "the child's end")


def _runs(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"
