"""Odd and damaged recordings, as people have them: each is one line, or a result that says what is left out."""

from __future__ import annotations

import itertools
import json
import random
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from recording_folders import depth_mm, write_seven_scenes, write_tum
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from test_compressed_depth import compressed, inverse, png, rvl
from test_ros_bag import T, bag, image, moved, record, tf, usual, with_covariance, without

from uav_recon.sensors.recordings.detection import ReadOptions, open_recording
from uav_recon.sensors.recordings.recording import RecordingError

FRAMES = 12
AT = (5, 5)  # a pixel with a return of 1.055 m in the first image
Messages = list[tuple[str, float, Any]]


@dataclass(frozen=True)
class Outcome:
    """What came of a recording: an error, or frames with their depth at AT, and what was said."""

    error: str = ""
    frames: int = 0
    depth_m: float = 0.0
    poses: int = 0
    said: str = ""


def outcome(path: Path) -> Outcome:
    try:
        recording = open_recording(path, ReadOptions())
        frames, poses = list(recording.frames()), recording.poses()
        recording.imu()
    except RecordingError as error:
        assert "\n" not in str(error)
        assert str(path.parent) in str(error)
        return Outcome(error=str(error))
    stamps_s = [frame.stamp_s for frame in frames]
    assert all(a < b for a, b in itertools.pairwise(stamps_s))
    said = "; ".join([*recording.info.remarks, *(f"{reason}: {count}" for reason, count in recording.info.skipped)])
    number = frames[0].sequence
    return Outcome("", len(frames), float(frames[0].depth_m[AT]) - 0.001 * number, len(poses), said)


def to_bag(path: Path, messages: Messages, mode: CompressionMode = CompressionMode.NONE) -> Path:
    return bag(path, StoragePlugin.SQLITE3, messages, mode)


def restamped(path: Path, stamps_s: list[float]) -> Path:
    """Write a TUM folder whose lists have these stamps; the images are those of the usual ones."""
    write_tum(path, len(stamps_s))
    for name in ("depth", "rgb"):
        lines = (path / f"{name}.txt").read_text().splitlines()[1:]
        lines = [f"{stamp_s!r} {line.split()[1]}" for stamp_s, line in zip(stamps_s, lines, strict=True)]
        (path / f"{name}.txt").write_text("\n".join(lines))
    return path


def steady() -> list[float]:
    return [100.0 + k / 30.0 for k in range(FRAMES)]


def changed(number: int, stamp_s: float) -> list[float]:
    stamps_s = steady()
    stamps_s[number] = stamp_s
    return stamps_s


def with_depth(path: Path, text: str, data: bytes) -> Path:
    images = [("/d/image_raw/x", s, compressed(s, text, data)) for t, s, _ in usual(FRAMES) if t == "/d/image_raw"]
    return to_bag(path, [*without(usual(FRAMES), "/d/image_raw"), *images])


def shortened(path: Path, share: float) -> Path:
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    return path


def mcap(path: Path) -> Path:
    record(path, FRAMES).close()
    return path


def depth_m() -> np.ndarray:
    metres = depth_mm(0) * 0.001
    metres[0, :2] = np.nan
    return metres


def damaged_image(path: Path) -> Path:
    messages = usual(FRAMES)
    broken = [m for t, _, m in messages if t == "/d/image_raw"][5]
    object.__setattr__(broken, "data", np.zeros(0, np.uint8))
    return to_bag(path, messages)


def cut_message(path: Path) -> Path:
    (file,) = to_bag(path, usual(FRAMES)).glob("*.db3")
    with closing(sqlite3.connect(file)) as database, database:
        (topic,) = database.execute("SELECT id FROM topics WHERE name = '/d/image_raw'").fetchone()
        (number,) = database.execute("SELECT MIN(id) + 9 FROM messages WHERE topic_id = ?", (topic,)).fetchone()
        database.execute("UPDATE messages SET data = X'0001' WHERE id = ?", (number,))
    return path


def another_size(path: Path, count: int) -> Path:
    """Write a bag whose first depth images are of another size than its CameraInfo."""
    small, messages = depth_mm(0)[:24, :32], usual(FRAMES)
    first = [s for t, s, _ in messages if t == "/d/image_raw"][:count]
    return to_bag(
        path, [(t, s, image(s, small, "16UC1")) if t[:2] == "/d" and s in first else (t, s, m) for t, s, m in messages]
    )


def poses_only_tf(path: Path) -> Path:
    stamps_s = [s for t, s, _ in usual(FRAMES) if t == "/pose"]
    transforms = [tf("/tf", s, moved(s, k, "odom", "optical")) for k, s in enumerate(stamps_s)]
    return to_bag(path, [*without(usual(FRAMES), "/pose"), *transforms])


def poses_with_covariance(path: Path) -> Path:
    stamps_s = [s for t, s, _ in usual(FRAMES) if t == "/pose"]
    return to_bag(path, [*without(usual(FRAMES), "/pose"), *(with_covariance(s, k) for k, s in enumerate(stamps_s))])


def shifted_bag(path: Path, number: int, seconds: float) -> Path:
    """Write a bag whose stamps of the headers are later by some seconds from an image on."""
    out: Messages = []
    for topic, stamp_s, message in usual(FRAMES):
        late_s = seconds if stamp_s >= 2.0 + number / 30.0 - 1e-3 else 0.0
        stamp = message.header.stamp
        object.__setattr__(stamp, "sec", stamp.sec + int(late_s))
        out.append((topic, stamp_s + late_s, message))
    return to_bag(path, out)


def flight(path: Path, text: str) -> Path:
    (path / "keyframes").mkdir(parents=True)
    (path / "keyframes/poses.json").write_text(text)
    return path


def tum_without(path: Path, kept: int) -> Path:
    write_tum(path, FRAMES)
    for file in sorted((path / "depth").iterdir())[kept:]:
        file.unlink()
    return path


def tum_with_other_colour(path: Path) -> Path:
    write_tum(path, FRAMES)
    text = (path / "rgb.txt").read_text().replace("\n100.", "\n200.")
    (path / "rgb.txt").write_text(text.replace("rgb/200.", "rgb/100."))
    return path


def seven(path: Path, name: str, data: bytes | None) -> Path:
    write_seven_scenes(path, FRAMES)
    if data is None:
        (path / name).unlink()
    else:
        (path / name).write_bytes(data)
    return path


SHUFFLED = random.Random(3).sample(steady(), FRAMES)
DURATIONS = [0.033 + 0.004 * random.Random(4 + k).uniform(-1, 1) for k in range(FRAMES)]
JPEG = bytes(cv2.imencode(".jpg", np.full((48, 64, 3), 90, np.uint8))[1].tobytes())
HEADER_INVERSE, PIXELS_INVERSE = inverse(depth_m())
MM = np.where(depth_mm(0) == 65535, 0, depth_mm(0)).astype(np.uint16)

# name: how it is written, how many frames are read (0: an error), what is said
CASES: dict[str, tuple[Callable[[Path], Path], int, str]] = {
    "nothing odd": (lambda p: to_bag(p, usual(FRAMES)), FRAMES, ""),
    "inverse depth": (lambda p: with_depth(p, "32FC1; compressedDepth png", HEADER_INVERSE + png(PIXELS_INVERSE)), FRAMES, ""),
    "inverse depth by rvl": (
        lambda p: with_depth(p, "32FC1; compressedDepth rvl", HEADER_INVERSE + rvl(PIXELS_INVERSE)), FRAMES, "",
    ),
    "millimetres by rvl": (lambda p: with_depth(p, "16UC1; compressedDepth rvl", bytes(12) + rvl(MM)), FRAMES, ""),
    "inverse depth without its numbers": (
        lambda p: with_depth(p, "32FC1; compressedDepth png", png(PIXELS_INVERSE)), 0, "without the 12 bytes before the PNG",
    ),
    "depth as JPEG": (lambda p: with_depth(p, "16UC1; jpeg compressed", JPEG), 0, "has no depth image (16UC1 or 32FC1)"),
    "unknown codec": (lambda p: with_depth(p, "16UC1; compressedDepth zfp", b"\x00" * 40), 0, "is no known image"),
    "durations as stamps": (lambda p: restamped(p, DURATIONS), 0, "stamps are out of order"),
    "shuffled stamps": (lambda p: restamped(p, SHUFFLED), 0, "stamps are out of order"),
    "nanoseconds": (lambda p: restamped(p, [1e9 * s for s in steady()]), 0, "they look like nanoseconds, divide them"),
    "milliseconds": (lambda p: restamped(p, [1e3 * s for s in steady()]), 0, "they look like milliseconds, divide them"),
    "equal stamps": (lambda p: restamped(p, [100.0] * FRAMES), 0, "all 12 stamps are 100 s"),
    "one repeated stamp": (lambda p: restamped(p, changed(4, steady()[3])), FRAMES - 1, "frames with the stamp of another: 1"),
    "one swapped pair": (lambda p: restamped(p, [*steady()[:4], steady()[5], steady()[4], *steady()[6:]]), FRAMES, ""),
    "a stamp of zero": (lambda p: restamped(p, changed(4, 0.0)), FRAMES - 1, "far from those beside it: 1"),
    "a pause of 700 s": (
        lambda p: shifted_bag(p, 8, 700.0), 8, "gap of 700 s after 2.233 s: used 8 of 12 frames, 2.000 to 2.233 s",
    ),
    "an image of no bytes": (damaged_image, FRAMES - 1, "0 bytes for 64 x 48 16UC1): 1"),
    "two images of another size": (lambda p: another_size(p, 2), FRAMES - 2, "is 32 x 24, and its CameraInfo 64 x 48): 2"),
    "a CameraInfo of another size": (
        lambda p: another_size(p, FRAMES), 0, "none of 12 frames can be read, the first: ",
    ),
    "a message of two bytes": (cut_message, FRAMES - 1, "frames whose stamp is no number: 1"),
    "zstd of messages": (lambda p: to_bag(p, usual(FRAMES), CompressionMode.MESSAGE), FRAMES, ""),
    "zstd of the file": (lambda p: to_bag(p, usual(FRAMES), CompressionMode.FILE), FRAMES, ""),
    "poses with covariance": (poses_with_covariance, FRAMES, ""),
    "poses in /tf": (poses_only_tf, FRAMES, ""),
    "no poses but Path": (
        lambda p: to_bag(p, [*without(usual(FRAMES), "/pose"),
                             ("/path", 2.0, T["nav_msgs/msg/Path"](header=usual(1)[2][2].header, poses=[]))]),
        FRAMES, "no poses are used; found and not read: /path (nav_msgs/msg/Path)",
    ),
    "cut mcap": (lambda p: shortened(mcap(p.with_suffix(".mcap")), 0.98), FRAMES, "the file is cut: it is read up to "),
    "mcap cut in its first chunk": (lambda p: shortened(mcap(p.with_suffix(".mcap")), 0.3), 0, ", and is cut; it has no image"),
    "cut db3": (lambda p: shortened(next(to_bag(p, usual(FRAMES)).glob("*.db3")), 0.5), 0, "damaged or cut"),
    "damaged poses.json": (lambda p: flight(p, '{"keyframes": [\n{"sequence": 1,'), 0, "is no JSON from line 2, column 16 on"),
    "poses.json of others": (lambda p: flight(p, json.dumps({"frames": []})), 0, "not a keyframe list: 'keyframes' is missing"),
    "TUM folder without its images": (lambda p: tum_without(p, 0), 0, "none of its 12 images exists, the first: depth/100"),
    "TUM folder without some images": (lambda p: tum_without(p, 9), 9, "images listed but missing: 3"),
    "TUM folder with colour of another time": (
        tum_with_other_colour, 0, "within 0.02 s: depth.txt is 100.000 to 100.367 s, rgb.txt is 200",
    ),
    "missing PNG": (lambda p: seven(p, "frame-000003.color.png", None), FRAMES - 1, "(No such file or directory)): 1"),
    "empty PNG": (lambda p: seven(p, "frame-000003.depth.png", b""), FRAMES - 1, "3.depth.png: has no bytes): 1"),
    "cut PNG": (lambda p: seven(p, "frame-000003.depth.png", png(MM)[:60]), FRAMES - 1, "3.depth.png: damaged or cut"),
    "cut JPEG": (lambda p: seven(p, "frame-000003.color.png", JPEG[:300]), FRAMES - 1, "3.color.png: is no known image"),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_an_odd_recording_is_one_line_or_a_full_result(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write, frames, said = CASES[name]
    found = outcome(write(tmp_path / "r"))
    assert capfd.readouterr() == ("", ""), "no library prints its own warning"
    if frames == 0:
        assert said in found.error, found
        return
    assert (found.error, found.frames) == ("", frames), found
    assert found.depth_m == pytest.approx(1.055, abs=0.006), "the first depth is right"
    assert said in found.said, found
    expected = {"no poses but Path": 0, "cut mcap": found.poses, "a pause of 700 s": 8}
    assert found.poses == expected.get(name, FRAMES)
    if not said:
        assert found.said in (
            "",
            "the poses name no body: they count as those of the camera in optical axes (else --pose-of body)",
        )
