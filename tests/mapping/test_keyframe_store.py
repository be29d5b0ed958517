from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from uav_recon.mapping.keyframe_store import KeyframeError, KeyframeFolder
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame
from uav_recon.types.pose import MapCorrection, Pose


def _view(seed: int) -> PosedFrame:
    random = np.random.default_rng(seed)
    depth = random.uniform(0.3, 6.0, (24, 32)).astype(np.float32)
    depth[3, 4:9] = np.nan
    ramp = np.linspace(0, 255, 40, dtype=np.uint8)
    rgb = np.stack(np.broadcast_arrays(ramp[None, :], ramp[:30, None], np.uint8(seed * 9)), axis=-1)
    lens, colour = Intrinsics.from_fov(32, 24, 1.5, 1.0), Intrinsics.from_fov(40, 30, 1.2, 0.7)
    frame = Frame(seed + 0.25, seed, depth, lens, rgb, colour, Pose.from_yaw(0.1, np.array([0.015, 0.0, 0.0])))
    return PosedFrame(frame, Pose.from_yaw(0.3 * seed, np.array([1.0, 2.0, seed])), map_epoch=seed % 2)


def test_a_keyframe_is_loaded_as_it_was_saved(tmp_path: Path) -> None:
    writer = KeyframeFolder(tmp_path / "keyframes")
    views = [_view(n) for n in range(3)]
    assert [writer.save(view) for view in views] == [0, 1, 2]
    reader = KeyframeFolder(tmp_path / "keyframes")
    assert len(reader) == 3
    for number, view in enumerate(views):
        back = reader.load(number)
        np.testing.assert_allclose(back.frame.depth_m, view.frame.depth_m, atol=0.0006)
        assert np.array_equal(np.isnan(back.frame.depth_m), np.isnan(view.frame.depth_m))
        assert np.abs(back.frame.rgb.astype(int) - view.frame.rgb).mean() < 6
        assert back.frame.depth_intrinsics == view.frame.depth_intrinsics
        assert back.frame.rgb_intrinsics == view.frame.rgb_intrinsics
        assert (back.frame.stamp_s, back.frame.sequence, back.map_epoch) == (number + 0.25, number, number % 2)
        np.testing.assert_allclose(back.world_from_depth.matrix(), view.world_from_depth.matrix(), atol=1e-12)
        np.testing.assert_allclose(back.frame.rgb_from_depth.matrix(), view.frame.rgb_from_depth.matrix(), atol=1e-12)


def test_a_reader_sees_later_keyframes_and_no_partial_ones(tmp_path: Path) -> None:
    writer = KeyframeFolder(tmp_path)
    reader = KeyframeFolder(tmp_path)
    assert len(reader) == 0
    writer.save(_view(0))
    reader.refresh()
    assert len(reader) == 1
    assert not list(tmp_path.glob("*.part"))


def test_poses_read_incrementally_equal_those_read_at_once(tmp_path: Path) -> None:
    writer, reader = KeyframeFolder(tmp_path), KeyframeFolder(tmp_path)
    for n in range(5):
        writer.save(_view(n))
        if n != 2:
            reader.refresh()
    whole = json.loads((tmp_path / "poses.json").read_text())
    assert whole["keyframes"] == reader._entries == KeyframeFolder(tmp_path)._entries
    assert [entry["sequence"] for entry in whole["keyframes"]] == list(range(5))
    (tmp_path / "poses.json").write_text(json.dumps(whole, indent=1))  # written by another program
    reader.refresh()
    assert reader._entries == whole["keyframes"]
    other = KeyframeFolder(tmp_path)
    other.save(_view(5))
    reader.refresh()
    assert len(reader) == len(json.loads((tmp_path / "poses.json").read_text())["keyframes"]) == 6


def test_a_second_writer_continues_the_numbers(tmp_path: Path) -> None:
    KeyframeFolder(tmp_path).save(_view(0))
    assert KeyframeFolder(tmp_path).save(_view(1)) == 1


def test_damage_is_named(tmp_path: Path) -> None:
    folder = KeyframeFolder(tmp_path)
    folder.save(_view(0))
    with pytest.raises(KeyframeError, match="keyframe 5"):
        folder.load(5)
    (tmp_path / "0000_depth.png").write_bytes(b"not an image")
    with pytest.raises(KeyframeError, match="keyframe 0"):
        folder.load(0)
    (tmp_path / "poses.json").write_text("[")
    with pytest.raises(KeyframeError, match=r"poses\.json"):
        KeyframeFolder(tmp_path)


NESTED = "[" * 100_000


@pytest.mark.parametrize("text", [NESTED, '{"depth_unit_m": 0.001, "keyframes": [\n' + NESTED + "\n]}\n"])
def test_poses_nested_too_deeply_are_an_error(tmp_path: Path, text: str) -> None:
    (tmp_path / "poses.json").write_text(text)
    with pytest.raises(KeyframeError, match=r"poses\.json: not a list of keyframes"):
        KeyframeFolder(tmp_path)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("depth", "../secret.png", r"keyframe 0: file name '\.\./secret\.png' leads out of the folder"),
        ("rgb", "/etc/secret.jpg", "leads out of the folder"),
        ("rgb", "..", "leads out of the folder"),
        ("rgb", "", "leads out of the folder"),
        ("depth_intrinsics", {"fx": "400"}, "keyframe 0: intrinsics: fx '400' is not a number"),
        ("rgb_intrinsics", {"cy": None}, "keyframe 0: intrinsics: cy None is not a number"),
        ("rgb_intrinsics", {"fx": float("nan")}, "keyframe 0: intrinsics: fx nan is not a number"),
        ("depth_intrinsics", {"fy": 0.0}, "keyframe 0: intrinsics: fy 0.0 is not positive"),
        ("depth_intrinsics", {"width": 32.5}, "keyframe 0: intrinsics: width 32.5 is not a whole number"),
        ("depth_intrinsics", "none", "keyframe 0: intrinsics"),
    ],
)
def test_an_entry_that_cannot_be_used_is_named(tmp_path: Path, key: str, value: object, message: str) -> None:
    KeyframeFolder(tmp_path / "keyframes").save(_view(0))
    path = tmp_path / "keyframes" / "poses.json"
    (tmp_path / "secret.png").write_bytes((tmp_path / "keyframes" / "0000_depth.png").read_bytes())
    tree = json.loads(path.read_text())
    entry = tree["keyframes"][0]
    entry[key] = entry[key] | value if isinstance(value, dict) else value
    path.write_text(json.dumps(tree))
    with pytest.raises(KeyframeError, match=message):
        KeyframeFolder(tmp_path / "keyframes").load(0)


def test_a_new_map_epoch_moves_keyframes_or_leaves_them_without_a_pose(tmp_path: Path) -> None:
    writer = KeyframeFolder(tmp_path)
    for n in range(3):
        writer.save(_view(2 * n))
    reader = KeyframeFolder(tmp_path)
    there = Pose.from_yaw(1.0, np.array([0.1, 0.2, 0.3]))
    writer.repose(MapCorrection(4, np.array([4.25, 0.25, 77.0]), (there, Pose.identity(), there)))
    writer.save(dataclasses.replace(_view(7), map_epoch=4))
    reader.refresh()
    for folder in (writer, reader, KeyframeFolder(tmp_path)):
        assert (len(folder), folder.map_epoch) == (4, 4)
        assert folder.pose(1) is None
        with pytest.raises(KeyframeError, match="keyframe 1 has no place in map epoch 4"):
            folder.load(1)
        moved = folder.load(2)
        assert moved.map_epoch == 4
        np.testing.assert_allclose(moved.world_from_depth.matrix(), there.matrix(), atol=1e-12)
        np.testing.assert_allclose(folder.load(0).world_from_depth.matrix(), np.eye(4), atol=1e-12)


def test_a_correction_has_a_pose_for_each_stamp() -> None:
    with pytest.raises(ValueError, match="1 poses for stamps of shape"):
        MapCorrection(1, np.array([0.0, 1.0]), (Pose.identity(),))


@pytest.mark.parametrize("name", ["sequence", "map_epoch"])
def test_a_number_without_bound_is_a_damaged_keyframe(tmp_path: Path, name: str) -> None:
    KeyframeFolder(tmp_path).save(_view(0))
    path = tmp_path / "poses.json"
    path.write_text(path.read_text().replace(f'"{name}": 0', f'"{name}": Infinity'))
    with pytest.raises(KeyframeError, match="keyframe 0: cannot convert float infinity"):
        KeyframeFolder(tmp_path).load(0)
