"""The map that a flight leaves is found by the next one, and never at a wrong place."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from slam_flight import BODY_FROM_DEPTH, RATE_HZ, fly, frame, frames, rendered, truth

from uav_recon.clock import InlineExecutor, ManualClock
from uav_recon.localization.slam.flown_map import FlownMap, ForeignMapError
from uav_recon.localization.slam.kept_map import KeptMap, is_map, write
from uav_recon.localization.slam.keyframe_map import KeyframeMap
from uav_recon.localization.slam.prepared_view import PreparedView
from uav_recon.localization.slam.slam_tracker import SlamTracker
from uav_recon.types.camera import Frame
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
def flown() -> FlownMap:
    return FlownMap.of(surfaces())


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
    write(tmp_path / "map.npz", flown())
    found = kept(tmp_path / "map.npz")
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
    write(tmp_path / "map.npz", flown())
    found = kept(tmp_path / "map.npz")
    for n in range(20):
        seen, odom_from_depth = later_frame(18)
        found.look(replace(seen, stamp_s=float(n)), odom_from_depth)
    assert found.earlier_from_odom is None


def test_odometry_that_wanders_is_not_placed(tmp_path: Path) -> None:
    write(tmp_path / "map.npz", flown())
    found = kept(tmp_path / "map.npz")
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
    again = FlownMap.from_bytes(flown().to_bytes())
    assert again.count == flown().count >= 10
    assert np.abs(again.keyframes.depth_m - flown().keyframes.depth_m).max() <= 0.00051
    for name in ("camera", "rotation", "place_m", "variance"):
        assert np.array_equal(getattr(again.keyframes, name), getattr(flown().keyframes, name))
    assert np.array_equal(again.bits, flown().bits)
    assert np.allclose(again.corners_m, flown().corners_m, atol=1e-5)


def _cut(data: bytes) -> bytes:
    return data[: len(data) // 2]


def _garbage(data: bytes) -> bytes:
    return bytes(range(256)) * 4


def _changed(data: bytes) -> bytes:
    """Return a map whose corners do not fit its keyframes."""
    whole = FlownMap.from_bytes(data)
    return replace(whole, first=whole.first + 1).to_bytes()


def _infinite(data: bytes) -> bytes:
    whole = FlownMap.from_bytes(data)
    place_m = whole.keyframes.place_m.copy()
    place_m[3, 1] = np.inf
    return replace(whole, keyframes=whole.keyframes._replace(place_m=place_m)).to_bytes()


@pytest.mark.parametrize("damage", [_cut, _garbage, _changed, _infinite, lambda data: b""])
def test_a_damaged_file_is_refused_and_never_replaced(damage, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    file = tmp_path / "map.npz"
    file.write_bytes(damage(flown().to_bytes()))
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
    file, clock = tmp_path / "map.npz", ManualClock(0.0)
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
    wrong = kept(tmp_path / "wrong.npz", surfaces())
    wrong.update(at_rest=False, wrong=True)
    wrong.update(at_rest=True, wrong=False)
    empty = kept(tmp_path / "empty.npz")
    empty.update(at_rest=False, wrong=False)
    empty.update(at_rest=True, wrong=False)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_gone_ends_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write(tmp_path / "gone" / "map.npz", flown())
    assert "cannot be written (No such file or directory)" in caplog.text
