from __future__ import annotations

from pathlib import Path

import pytest
import torch

from uav_recon.mapping.neural.sdf_torch.checkpoint import BEFORE, LAST, CheckpointMismatchError, Identity, RefineCheckpoints

RUN: Identity = {"steps": 100, "voxel_m": 0.01, "flight": "abc"}


def state(number: float) -> dict[str, torch.Tensor]:
    return {"weights": torch.full((5,), number), "steps": torch.tensor(int(number))}


@pytest.fixture
def two(tmp_path: Path) -> RefineCheckpoints:
    """Return a checkpoint folder after two saves."""
    checkpoints = RefineCheckpoints(tmp_path / "refined", RUN)
    checkpoints.save(state(1))
    checkpoints.save(state(2))
    return checkpoints


def test_the_newest_checkpoint_is_loaded(two: RefineCheckpoints) -> None:
    held, said = two.load()
    assert held is not None
    assert int(held["steps"]) == 2
    assert torch.equal(held["weights"], state(2)["weights"])
    assert said == []


def test_an_empty_folder_has_no_checkpoint(tmp_path: Path) -> None:
    assert RefineCheckpoints(tmp_path, RUN).load() == (None, [])


@pytest.mark.parametrize("damage", [b"", b"short", b"x" * 4000])
def test_a_damaged_checkpoint_is_named_and_the_previous_loaded(two: RefineCheckpoints, tmp_path: Path, damage: bytes) -> None:
    (tmp_path / "refined" / LAST).write_bytes(damage)
    held, said = two.load()
    assert held is not None
    assert int(held["steps"]) == 1
    assert said == [f"{tmp_path / 'refined' / LAST}: damaged, left aside"]


def test_one_flipped_bit_is_damage(two: RefineCheckpoints, tmp_path: Path) -> None:
    path = tmp_path / "refined" / LAST
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    held, said = two.load()
    assert held is not None
    assert int(held["steps"]) == 1
    assert len(said) == 1


def test_with_both_damaged_a_run_starts_from_the_beginning(two: RefineCheckpoints, tmp_path: Path) -> None:
    for name in (LAST, BEFORE):
        (tmp_path / "refined" / name).write_bytes(b"broken")
    held, said = two.load()
    assert held is None
    assert len(said) == 2


def test_a_kill_between_the_renames_leaves_the_previous_checkpoint(two: RefineCheckpoints, tmp_path: Path) -> None:
    (tmp_path / "refined" / LAST).replace(tmp_path / "refined" / BEFORE)  # the first of the two renames
    held, said = two.load()
    assert held is not None
    assert int(held["steps"]) == 2
    assert said == []


def test_a_kill_during_a_save_leaves_the_last_checkpoint(
    two: RefineCheckpoints, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    def torn(descriptor: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("os.fsync", torn)
    with pytest.raises(KeyboardInterrupt):
        two.save(state(3))
    held, said = two.load()
    assert held is not None
    assert int(held["steps"]) == 2
    assert said == []


def test_a_checkpoint_of_another_run_is_refused_and_the_differences_are_named(two: RefineCheckpoints, tmp_path: Path) -> None:
    other = RefineCheckpoints(tmp_path / "refined", RUN | {"voxel_m": 0.02, "steps": 200})
    with pytest.raises(CheckpointMismatchError, match=r"steps 100 there, 200 here, voxel_m 0\.01 there, 0\.02 here"):
        other.load()
