"""The map that a flight leaves is found by the next one, and never at a wrong place."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from slam_flight import BODY_FROM_DEPTH, RATE_HZ, fly, frame, frames, rendered, truth

from uav_recon.clock import InlineExecutor, ManualClock
from uav_recon.localization.slam.flown_map import FlownMap, ForeignMapError, copied, file_of
from uav_recon.localization.slam.kept_map import KeptMap, is_map, write
from uav_recon.localization.slam.keyframe_map import KeyframeMap
from uav_recon.localization.slam.prepared_view import PreparedView
from uav_recon.localization.slam.slam_tracker import SlamTracker
from uav_recon.types.camera import Frame
from uav_recon.types.frames import AnyArray
from uav_recon.types.pose import Pose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

SECONDS = 12.0
BEGAN = Pose.from_yaw(math.radians(70.0), np.array([0.4, -0.5, 0.0]))  # of the later flight, in odom of the first one


@functools.cache
def surfaces() -> KeyframeMap:
    """Return the tracker's map of the first flight."""
    tracker = SlamTracker()
    fly(tracker, frames(SECONDS))
    return tracker.surfaces


@functools.cache
def arrays() -> dict[str, AnyArray]:
    return copied(surfaces())


@functools.cache
def flown() -> FlownMap:
    return FlownMap.from_bytes(file_of(arrays()))


def later_frame(number: int) -> tuple[Frame, Pose]:
    """Return a frame of a flight that begins at BEGAN, and odom_from_depth of it."""
    t = number / RATE_HZ
    earlier_from_body = truth(t)
    depth, rgb = rendered(earlier_from_body @ BODY_FROM_DEPTH, 1000 + number)
    return replace(frame(0), stamp_s=t, depth_m=depth, rgb=rgb), BEGAN.inverse() @ earlier_from_body @ BODY_FROM_DEPTH


def kept(file: Path, own: KeyframeMap | None = None, clock: ManualClock | None = None) -> KeptMap:
    return KeptMap(file, lambda: own or KeyframeMap(), InlineExecutor(clock or ManualClock(0.0)))


def said(found: KeptMap) -> Reason:
    assert found.reason is not None
    return found.reason


def look(found: KeptMap, numbers: range, odom: Pose | None = None) -> None:
    """Show frames of the later flight."""
    for number in numbers:
        seen, odom_from_depth = later_frame(number)
        found.look(seen, odom_from_depth if odom is None else odom @ odom_from_depth)


def test_a_flight_finds_where_it_began_in_the_map_of_the_one_before(tmp_path: Path) -> None:
    write(tmp_path / "map.bin", arrays())
    found = kept(tmp_path / "map.bin")
    assert said(found).code is ReasonCode.EARLIER_MAP_SEARCHED
    look(found, range(18, 150, 5))
    assert found.earlier_from_odom is not None
    off = BEGAN.inverse() @ found.earlier_from_odom
    assert np.linalg.norm(off.translation_m) < 0.05
    assert np.linalg.norm(off.rotation_vector()) < math.radians(1.0)
    assert said(found).code is ReasonCode.EARLIER_MAP_FOUND
    assert said(found).values[:2] == pytest.approx((0.4, -0.5), abs=0.05)
    assert said(found).values[3] == pytest.approx(70.0, abs=1.0)


def test_the_same_view_again_and_again_proves_nothing(tmp_path: Path) -> None:
    write(tmp_path / "map.bin", arrays())
    found = kept(tmp_path / "map.bin")
    for n in range(20):
        seen, odom_from_depth = later_frame(18)
        found.look(replace(seen, stamp_s=float(n)), odom_from_depth)
    assert found.earlier_from_odom is None


def test_a_flight_elsewhere_looks_less_and_less(tmp_path: Path) -> None:
    write(tmp_path / "map.bin", arrays())
    found = kept(tmp_path / "map.bin")
    seen, odom_from_depth = later_frame(18)
    bare = replace(seen, rgb=np.zeros_like(seen.rgb))
    looked_s = list[float]()
    for n in range(1000):
        found.look(replace(bare, stamp_s=0.1 * n), odom_from_depth)
        looked_s.append(found._looked_s)
    assert len(set(looked_s[:600])) == pytest.approx(60.0 / 0.3, abs=55)
    assert len(set(looked_s[600:])) == pytest.approx(40.0 / 2.0, abs=3)


def test_odometry_that_wanders_is_not_placed(tmp_path: Path) -> None:
    write(tmp_path / "map.bin", arrays())
    found = kept(tmp_path / "map.bin")
    for k, number in enumerate(range(18, 150, 5)):  # 0.3 m farther with each view: no two agree
        look(found, range(number, number + 1), Pose(np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.3 * k, 0.0, 0.0])))
    assert found.earlier_from_odom is None


def test_another_vertical_is_another_place() -> None:
    seen, odom_from_depth = later_frame(18)
    view = PreparedView(seen)
    tilted = Pose.from_rotation_vector(np.array([math.radians(7.0), 0.0, 0.0]), np.zeros(3))
    assert flown().place(view, odom_from_depth) is not None
    assert flown().place(view, tilted @ odom_from_depth) is None


def test_surfaces_that_are_gone_refute_a_place() -> None:
    seen, odom_from_depth = later_frame(18)
    nearer = replace(seen, depth_m=0.7 * seen.depth_m)
    assert flown().place(PreparedView(nearer), odom_from_depth) is None


def test_a_map_survives_its_file() -> None:
    left, every = flown(), surfaces().every()
    assert left.count == surfaces().count >= 10
    assert np.abs(left.keyframes.depth_m - every.depth_m[: left.count]).max() <= 0.00051
    for name in ("camera", "rotation", "place_m", "variance"):
        assert np.array_equal(getattr(left.keyframes, name), getattr(every, name)[: left.count])
    bits, corners_m = surfaces().described(3)
    known, of = np.isfinite(corners_m[:, 0]), slice(left.first[3], left.first[4])
    assert np.array_equal(left.bits[of], bits[known])
    assert np.allclose(left.corners_m[of], corners_m[known], atol=1e-5)


def _cut() -> bytes:
    whole = file_of(arrays())
    return whole[: len(whole) // 2]


def _flipped() -> bytes:
    """Return a file with one wrong bit amid its compressed arrays, which zlib may not survive."""
    whole = bytearray(file_of(arrays()))
    whole[len(whole) // 2] ^= 4
    return bytes(whole)


def _garbage() -> bytes:
    return bytes(range(256)) * 4


def _does_not_fit() -> bytes:
    return file_of({**arrays(), "first": arrays()["first"] + 1})


def _infinite() -> bytes:
    place_m = arrays()["place_m"].copy()
    place_m[3, 1] = np.inf
    return file_of({**arrays(), "place_m": place_m})


def _without_poses() -> bytes:
    return file_of({name: array for name, array in arrays().items() if name != "rotation"})


def _of_the_future() -> bytes:
    return file_of({**arrays(), "format": np.array(99)})


@pytest.mark.parametrize("damage", [_cut, _flipped, _garbage, _does_not_fit, _infinite, _without_poses, _of_the_future, bytes])
def test_a_damaged_file_is_refused_and_never_replaced(damage: Callable[[], bytes], tmp_path: Path) -> None:
    file = tmp_path / "map.bin"
    file.write_bytes(damage())
    before = file.read_bytes()
    with pytest.raises(ForeignMapError):
        FlownMap.from_bytes(before)
    assert not is_map(file)
    found = kept(file, surfaces())
    assert found.reason is not None
    assert found.reason.code is ReasonCode.EARLIER_MAP_IGNORED
    look(found, range(18, 30))
    found.update(at_rest=False, wrong=False)
    found.update(at_rest=True, wrong=False)
    found.close()
    assert file.read_bytes() == before


def test_a_flight_leaves_its_map_once_it_rests(tmp_path: Path) -> None:
    file, clock = tmp_path / "map.bin", ManualClock(0.0)
    left = kept(file, surfaces(), clock)
    assert left.reason is None
    left.update(at_rest=True, wrong=False)
    assert not file.exists()  # it has not moved
    left.update(at_rest=False, wrong=False)
    assert not file.exists()
    left.update(at_rest=True, wrong=False)
    assert is_map(file)
    file.unlink()
    left.update(at_rest=True, wrong=False)
    left.close()
    assert not file.exists()  # nothing new to write
    left.update(at_rest=False, wrong=False)
    clock.advance_to(1.0)
    left.close()
    assert is_map(file)


def test_a_flight_that_was_wrong_once_or_saw_nothing_leaves_no_map(tmp_path: Path) -> None:
    wrong = kept(tmp_path / "wrong.bin", surfaces())
    wrong.update(at_rest=False, wrong=True)
    wrong.update(at_rest=True, wrong=False)
    empty = kept(tmp_path / "empty.bin")
    empty.update(at_rest=False, wrong=False)
    empty.update(at_rest=True, wrong=False)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_gone_ends_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write(tmp_path / "gone" / "map.bin", arrays())
    assert "cannot be written (No such file or directory)" in caplog.text
