from __future__ import annotations

import io
import os
import pickle
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from box_room import BASELINE_M, HIGH, LOW, NOISE_PX, look, tour

from uav_recon.config import MapperConfig
from uav_recon.mapping.keyframe_store import KeyframeFolder
from uav_recon.mapping.neural.keyframes import keyframe_buffer, ray_buffer
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.mapping.neural.worker import checkpoint
from uav_recon.mapping.neural.worker.checkpoint import EVERY_VIEWS, CheckpointError, MapperCheckpoints

CONFIG, ORDER = MapperConfig(), {"config": {"seed": 0}, "box_min_m": [0.0, 0.0, 0.0]}
VIEWS, STEPS = EVERY_VIEWS + 4, 6


class Flight:
    """Mapper trained on VIEWS keyframes of the box room.

    A checkpoint is saved after the first EVERY_VIEWS of them.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.path = folder / "checkpoint"
        self.keyframes = KeyframeFolder(folder / "keyframes")
        for view in tour(VIEWS, NOISE_PX):
            self.keyframes.save(view)
        self.trainer = NeuralMapper(CONFIG, LOW, HIGH, NOISE_PX, BASELINE_M)
        checkpoints = MapperCheckpoints(self.path, ORDER)
        for number in range(VIEWS):
            learn(self.trainer, self.keyframes, number)
            if number == EVERY_VIEWS - 3:
                self.trainer.uncertainty = self.trainer.uncertainties["product"]
                self.trainer.surface()
            saved = checkpoints.save_if_due(self.trainer, number + 1, self.keyframes.stamp_s(number))
            assert saved == (number + 1 == EVERY_VIEWS)
        checkpoints.wait()


def learn(mapper: NeuralMapper, keyframes: KeyframeFolder, number: int) -> None:
    assert mapper.add(keyframes.load(number))
    mapper.train(STEPS)


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    return Flight(tmp_path_factory.mktemp("flight"))


def _assert_equal(a: NeuralMapper, b: NeuralMapper) -> None:
    for first, second in ((a.surface(), b.surface()), (a.all_surface_elements(), b.all_surface_elements())):
        assert len(first.position_world) > 1000
        assert np.array_equal(first.position_world, second.position_world)
        assert np.array_equal(first.normal_world, second.normal_world)
        assert np.array_equal(first.uncertainty, second.uncertainty)
        assert first.revision == second.revision
    assert np.array_equal(a.field.parameters, b.field.parameters)
    assert np.array_equal(a.field.grid.features, b.field.grid.features)
    assert a.steps == b.steps
    for name, measure in a.uncertainties.items():
        points = a.all_surface_elements().position_world[::50].astype(np.float32)
        assert np.array_equal(measure.at(points), b.uncertainties[name].at(points)), name


def test_training_after_a_restore_equals_uninterrupted_training(flight: Flight) -> None:
    found = MapperCheckpoints(flight.path, ORDER).load(flight.keyframes)
    assert found is not None
    restored, learned = found
    assert learned == restored.views == EVERY_VIEWS
    assert restored.uncertainty is restored.uncertainties["product"]
    for number in range(learned, VIEWS):
        learn(restored, flight.keyframes, number)
    _assert_equal(flight.trainer, restored)
    for mapper in (flight.trainer, restored):
        mapper.polish(8)
    meshes = [mapper.mesh(0.05) for mapper in (flight.trainer, restored)]
    assert np.array_equal(meshes[0].vertices_world, meshes[1].vertices_world)
    assert np.array_equal(meshes[0].rgb, meshes[1].rgb)
    assert np.array_equal(flight.trainer.corrections(), restored.corrections())


def test_a_restored_mapper_evicts_views_and_saves_checkpoints_as_the_first_did(
    flight: Flight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(keyframe_buffer, "MAX_VIEWS", EVERY_VIEWS + 1)
    monkeypatch.setattr(keyframe_buffer, "KEPT_VIEWS", EVERY_VIEWS - 2)
    monkeypatch.setattr(ray_buffer, "MAX_RAYS", 30_000)  # so that rays are thinned too
    first = NeuralMapper(CONFIG, LOW, HIGH, NOISE_PX, BASELINE_M)
    checkpoints = MapperCheckpoints(tmp_path / "checkpoint", ORDER)
    for number in range(VIEWS):
        learn(first, flight.keyframes, number)
        checkpoints.save_if_due(first, number + 1, flight.keyframes.stamp_s(number))
        checkpoints.wait()
    monkeypatch.setattr(checkpoint, "EVERY_VIEWS", 1)
    assert checkpoints.save_if_due(first, VIEWS, flight.keyframes.stamp_s(VIEWS - 1))
    checkpoints.wait()
    assert len(first.kept) < first.views == VIEWS
    names = {path.name for path in (tmp_path / "checkpoint").iterdir()}
    assert names == {"state", *(f"view_{number:06d}.npz" for number in first.kept)}
    found = MapperCheckpoints(tmp_path / "checkpoint", ORDER).load(flight.keyframes)
    assert found is not None
    for mapper in (first, found[0]):
        assert mapper.add(look((1.4, 1.0, 1.1), 77.0))
        mapper.train(STEPS)
    _assert_equal(first, found[0])


def test_no_checkpoint_is_none(tmp_path: Path, flight: Flight) -> None:
    assert MapperCheckpoints(tmp_path, ORDER).load(flight.keyframes) is None


def _flip(position: float) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        data = bytearray((folder / "state").read_bytes())
        data[int(position * (len(data) - 1))] ^= 0x10
        (folder / "state").write_bytes(data)

    return damage


def _cut(folder: Path) -> None:
    os.truncate(folder / "state", (folder / "state").stat().st_size // 2)


def _empty(folder: Path) -> None:
    (folder / "state").write_bytes(b"")


def _hurt_view(folder: Path) -> None:
    path = folder / "view_000003.npz"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def _lose_view(folder: Path) -> None:
    (folder / "view_000001.npz").unlink()


@pytest.mark.parametrize(
    "damage", [_flip(0.0), _flip(1e-6), _flip(1e-5), _flip(0.5), _flip(1.0), _cut, _empty, _hurt_view, _lose_view]
)
def test_a_damaged_checkpoint_is_named_and_not_used(flight: Flight, tmp_path: Path, damage: Callable[[Path], None]) -> None:
    copy = tmp_path / "checkpoint"
    subprocess.run(["cp", "-r", str(flight.path), str(copy)], check=True)
    damage(copy)
    with pytest.raises(CheckpointError, match=r"checkpoint/(state|view_\d+.npz).*(damaged|No such file)"):
        MapperCheckpoints(copy, ORDER).load(flight.keyframes)


@pytest.mark.parametrize("change", [{"config": {"seed": 1}}, {"box_min_m": [0.0, 0.0, 0.1]}, {"depth_noise_px": 1.0}])
def test_a_checkpoint_of_another_configuration_is_refused(flight: Flight, change: dict[str, Any]) -> None:
    with pytest.raises(CheckpointError, match="of another configuration, box or camera"):
        MapperCheckpoints(flight.path, ORDER | change).load(flight.keyframes)


def test_a_checkpoint_of_other_keyframes_is_refused(flight: Flight, tmp_path: Path) -> None:
    fewer, others = KeyframeFolder(tmp_path / "fewer"), KeyframeFolder(tmp_path / "others")
    for view in tour(3):
        fewer.save(view)
    for view in reversed(tour(VIEWS)):
        others.save(view)
    for keyframes in (fewer, others):
        with pytest.raises(CheckpointError, match="of other keyframes"):
            MapperCheckpoints(flight.path, ORDER).load(keyframes)


def test_a_checkpoint_of_other_code_is_refused(flight: Flight, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkpoint, "_code", lambda: "tomorrow's")
    with pytest.raises(CheckpointError, match="of another version"):
        MapperCheckpoints(flight.path, ORDER).load(flight.keyframes)


def test_a_write_error_loses_only_the_checkpoint(flight: Flight, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").write_text("not a folder")
    checkpoints = MapperCheckpoints(tmp_path / "file", ORDER)
    assert checkpoints.save_if_due(flight.trainer, VIEWS, 0.0)
    checkpoints.wait()
    assert "no checkpoint after 12 keyframes" in caplog.text


def test_unpickling_creates_only_mapper_classes_and_arrays() -> None:
    class Shell:
        def __reduce__(self) -> tuple[Any, ...]:
            return os.system, ("true",)

    with pytest.raises(pickle.UnpicklingError, match=r"posix\.system has no place"):
        checkpoint._Unpickler(io.BytesIO(pickle.dumps(Shell()))).load()
