from __future__ import annotations

import dataclasses
import math
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sitl.apps import rgbd_sequences
from sitl.apps.rgbd_sequences import (
    IMU_HZ,
    RgbdSequence,
    SequenceOptions,
    load,
    record,
    recorded,
    save,
    true_world_from_depth,
)
from sitl.geometry.transform import inverse
from sitl.scene.scene import Scene, load_scene
from sitl.truth.hull_clearance import HullClearance
from sitl.truth.random_route import NoRouteError, random_route
from sitl.truth.visibility import REACH_CLEARANCE_M
from uav_recon.types.frames import FloatArray

SHORT = SequenceOptions(camera_errors=0.0, length_m=2.0, depth_noise="none", camera="small")


@cache
def room() -> Scene:
    return load_scene(None, fine=False)


@cache
def taken(options: SequenceOptions) -> RgbdSequence:
    return record(options, room())


def disagreement_m(sequence: RgbdSequence, world_from_depth: FloatArray, step: int) -> float:
    """Return the median difference of depth images, each carried into the one step frames later."""
    s = sequence.header.depth
    u, v = np.meshgrid(np.arange(s.width), np.arange(s.height))
    wrong = []
    for n in range(40, len(sequence.stamp_s) - step, 12):
        z = 1e-3 * sequence.depth_mm[n]
        points = np.stack([(u - s.cx) / s.fx * z, (v - s.cy) / s.fy * z, z], axis=-1)[z > 0]
        later = inverse(world_from_depth[n + step]) @ world_from_depth[n]
        x, y, z = (points @ later[:3, :3].T + later[:3, 3]).T
        column, row = np.rint(s.fx * x / z + s.cx).astype(int), np.rint(s.fy * y / z + s.cy).astype(int)
        inside = (z > 0.3) & (column >= 0) & (column < s.width) & (row >= 0) & (row < s.height)
        shown = 1e-3 * sequence.depth_mm[n + step][row[inside], column[inside]]
        wrong.append(np.abs(shown - z[inside])[shown > 0])
    return float(np.median(np.concatenate(wrong)))


def test_depth_agrees_with_the_true_poses() -> None:
    sequence = taken(SHORT)
    poses = true_world_from_depth(sequence, SHORT)
    right_m = disagreement_m(sequence, poses, 8)
    late = np.concatenate([poses[15:], poses[-15:]])
    assert right_m < 0.006
    assert disagreement_m(sequence, late, 8) > 2.0 * right_m, "the poses of a second later"
    assert sequence.true_body == pytest.approx(sequence.shown_body, abs=1e-5), "an exact camera shows its stamp"


def test_depth_of_a_camera_with_errors_agrees_with_its_own_true_poses() -> None:
    errors = dataclasses.replace(SHORT, camera_errors=1.0, seed=3)
    sequence = taken(errors)
    drawn = errors.errors
    stretched = dataclasses.replace(
        sequence,
        header=dataclasses.replace(
            sequence.header,
            depth=dataclasses.replace(
                sequence.header.depth,
                fx=sequence.header.depth.fx * (1 + drawn.optics.depth_focal),
                fy=sequence.header.depth.fy * (1 + drawn.optics.depth_focal),
            ),
        ),
        depth_mm=(sequence.depth_mm / (1 + drawn.optics.depth_scale)).astype(np.uint16),
    )
    assert disagreement_m(stretched, true_world_from_depth(sequence, errors), 8) < 0.006
    now_m, shown_m = sequence.true_body[:, :3, 3], sequence.shown_body[:, :3, 3]
    speed_mps = np.linalg.norm(now_m - sequence.true_body_at(sequence.stamp_s - 0.02)[:, :3, 3], axis=1) / 0.02
    age_s = (np.linalg.norm(now_m - shown_m, axis=1) / np.maximum(speed_mps, 0.1))[speed_mps > 0.3]
    assert np.median(age_s) == pytest.approx(drawn.timing.age_s, abs=0.002)
    assert np.std(age_s) == pytest.approx(drawn.timing.jitter_s, rel=0.5)
    assert (sequence.arrival_s >= sequence.stamp_s - 1e-9).all()


def test_one_seed_and_path_is_one_sequence() -> None:
    options = dataclasses.replace(SHORT, camera_errors=1.0, depth_noise="d435i", seed=5)
    one, other = record(options, room()), record(options, room())
    for field in dataclasses.fields(RgbdSequence):
        assert np.array_equal(getattr(one, field.name), getattr(other, field.name)), field.name
    seed = taken(dataclasses.replace(SHORT, camera_errors=1.0, seed=3))
    assert np.array_equal(seed.truth_position_m, one.truth_position_m), "the path does not depend on the seed"
    assert not np.array_equal(seed.imu, one.imu)


def test_frames_and_samples_come_at_their_rates() -> None:
    sequence = taken(SHORT)
    assert np.diff(sequence.stamp_s) == pytest.approx(1.0 / 15.0, abs=1e-9)
    assert np.diff(sequence.imu[:, 0]) == pytest.approx(1.0 / IMU_HZ, abs=1e-9)
    assert sequence.imu[0, 1:] == pytest.approx([0, 0, 0, 0, 0, 9.80665], abs=1e-9)
    assert len(sequence.depth_mm) == len(sequence.rgb) == len(sequence.stamp_s) == len(sequence.body_from_depth)


def test_true_poses_between_stamps_follow_the_gyro() -> None:
    sequence = taken(SHORT)
    t = np.arange(sequence.truth_s[0] + 4.0, sequence.truth_s[-1] - 1.0, 0.0113)
    rotation = Rotation.from_matrix(sequence.true_body_at(t)[:, :3, :3])
    turned = np.linalg.norm((rotation[:-1].inv() * rotation[1:]).as_rotvec(), axis=1) / np.diff(t)
    gyro = np.interp(0.5 * (t[:-1] + t[1:]), sequence.imu[:, 0], np.linalg.norm(sequence.imu[:, 1:4], axis=1))
    assert np.abs(turned - gyro).max() < 0.02
    outside = sequence.true_body_at(np.array([-5.0, 1e6]))
    assert np.array_equal(outside, sequence.true_body_at(sequence.truth_s[[0, -1]]))


def test_a_gimbal_has_a_nominal_pose_for_each_frame() -> None:
    sequence = taken(dataclasses.replace(SHORT, gimbal=True, path=1, camera="fast"))
    pitch = np.arcsin(-sequence.body_from_depth[:, 2, 2])
    assert np.ptp(pitch) > math.radians(2.0)
    assert np.abs(np.diff(pitch)).max() * 15.0 < math.radians(31.0)


def test_a_stored_sequence_is_the_same_and_a_damaged_one_is_recorded_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[SequenceOptions] = []

    def counted(options: SequenceOptions, scene: Scene, report: rgbd_sequences.Progress) -> RgbdSequence:
        calls.append(options)
        return taken(options)

    monkeypatch.setattr(rgbd_sequences, "record", counted)
    first = recorded(SHORT, room(), tmp_path)
    assert len(calls) == 1
    (path,) = tmp_path.iterdir()
    again = recorded(SHORT, room(), tmp_path)
    assert len(calls) == 1
    assert again.header == first.header
    for field in dataclasses.fields(RgbdSequence):
        assert np.array_equal(getattr(again, field.name), getattr(first, field.name)), field.name
    path.write_bytes(path.read_bytes()[:1000])
    recorded(SHORT, room(), tmp_path)
    assert len(calls) == 2
    assert load(path).name == first.name
    save(first, path)
    recorded(dataclasses.replace(SHORT, glass=True), room(), tmp_path)
    assert len(calls) == 3, "other options, another file"


@pytest.mark.parametrize("number", range(3))
def test_a_route_keeps_clear_of_the_walls(number: int) -> None:
    route = random_route(room(), number, 12.0)
    points = np.array([leg.position_m for leg in route])
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).sum() >= 12.0
    share = np.linspace(0.0, 1.0, 40)[:, None]
    line = np.concatenate([a + share * (b - a) for a, b in pairwise(points)])
    assert HullClearance(room(), radius_m=0.0, height_m=0.0).batch(line).min() >= REACH_CLEARANCE_M - 0.10
    other = random_route(room(), number + 1, 12.0)
    assert [leg.position_m for leg in other] != [leg.position_m for leg in route]


def test_a_scene_without_space_has_no_route(monkeypatch: pytest.MonkeyPatch) -> None:
    only = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.0]], np.float32)
    monkeypatch.setattr("sitl.truth.random_route.reachable_positions", lambda scene: only)
    with pytest.raises(NoRouteError, match=r"no free leg of 0\.8 m or more"):
        random_route(room(), 0, 5.0)
