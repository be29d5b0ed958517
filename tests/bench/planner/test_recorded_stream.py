from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from small_recorded_stream import LENS, SIZE, write_stream

from uav_recon.bench.planner.recorded_stream import load
from uav_recon.errors import UserError
from uav_recon.types.maps import OCCUPIED


def test_reads_metres_poses_and_the_lens(tmp_path: Path) -> None:
    recording = load(write_stream(tmp_path / "s"), SIZE, 2)
    assert (recording.name, recording.stride, recording.lens) == ("s", 2, LENS)
    assert len(recording.frames) == 6
    frame = recording.frames[0].frame
    assert frame.depth_m.shape == (24, 32)
    np.testing.assert_allclose(frame.depth_m[12, 16], 1.0, atol=1e-3)
    np.testing.assert_allclose(recording.frames[0].world_from_depth.rotation()[:, 2], [1, 0, 0], atol=1e-12)
    assert recording.grid.shape == (20, 20, 20)
    assert recording.reference is None


def test_zero_is_beyond_the_range(tmp_path: Path) -> None:
    recording = load(write_stream(tmp_path / "s"), SIZE, 1)
    assert (recording.frames[0].frame.depth_m[-1] > recording.max_range_m).all()


def test_reads_the_reference_in_the_states_of_a_map(tmp_path: Path) -> None:
    folder = write_stream(tmp_path / "s")
    np.full(8000, 2, dtype=np.int8).tofile(folder / "occupancy_reference.i8")
    reference = load(folder, SIZE, 1).reference
    assert reference is not None
    assert reference.shape == (20, 20, 20)
    assert (reference == OCCUPIED).all()


@pytest.mark.parametrize("lost", ["meta.json", "poses.npy", f"depth_{SIZE}.npz"])
def test_a_missing_file_is_named(tmp_path: Path, lost: str) -> None:
    folder = write_stream(tmp_path / "s")
    (folder / lost).unlink()
    with pytest.raises(UserError, match=lost):
        load(folder, SIZE, 1)


def test_a_missing_folder_a_wrong_size_and_a_wrong_stride_state_the_allowed_values(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="nowhere: no such folder; want"):
        load(tmp_path / "nowhere", SIZE, 1)
    folder = write_stream(tmp_path / "s")
    with pytest.raises(UserError, match="--size 640x480: want one of 32x24"):
        load(folder, "640x480", 1)
    with pytest.raises(UserError, match="--stride 0: want 1 to 8"):
        load(folder, SIZE, 0)


def test_damaged_files_are_a_one_line_error(tmp_path: Path) -> None:
    folder = write_stream(tmp_path / "s")
    for name, content in (("poses.npy", b"no"), (f"depth_{SIZE}.npz", b"PK\x03\x04no"), ("occupancy_reference.i8", b"123")):
        kept = (folder / name).read_bytes() if (folder / name).exists() else None
        (folder / name).write_bytes(content)
        with pytest.raises(UserError, match=name) as raised:
            load(folder, SIZE, 1)
        assert "\n" not in str(raised.value)
        (folder / name).unlink() if kept is None else (folder / name).write_bytes(kept)
    np.save(folder / "poses.npy", np.zeros((3, 4, 4)))
    with pytest.raises(UserError, match=r"poses.npy: shape \(3, 4, 4\), want \(6, 4, 4\)"):
        load(folder, SIZE, 1)


def test_meta_without_a_room_is_named(tmp_path: Path) -> None:
    folder = write_stream(tmp_path / "s")
    meta = json.loads((folder / "meta.json").read_text())
    del meta["room"]
    (folder / "meta.json").write_text(json.dumps(meta))
    with pytest.raises(UserError, match="room"):
        load(folder, SIZE, 1)


def test_meta_without_an_image_size_is_an_error(tmp_path: Path) -> None:
    folder = write_stream(tmp_path / "s")
    (folder / "meta.json").write_text("{}")
    with pytest.raises(UserError, match=r"meta\.json: names no image size") as raised:
        load(folder, SIZE, 1)
    assert raised.value.code == 2
