"""Faults of one measurement of the motion: the pose source, the inertial sensors, the depth, the autopilot's heading."""

from __future__ import annotations

import dataclasses
import math
import random
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sitl.camera.d435i import FAST_DEPTH_SPEC
from sitl.faults.fault import Fault
from sitl.faults.fault_director import FaultDirector
from sitl.faults.injectors import depth_camera, inertial_sensor, pose_stream
from sitl.faults.injectors.base import DepthFrame, InjectionContext, Injector, StreamedImuSample
from sitl.faults.injectors.vehicle_and_autopilot import HEADING_OFF, HeadingError, PropellerTouch
from sitl.faults.table.scenario import standing_conditions
from sitl.geometry.quaternion import from_yaw, yaw_of
from sitl.world.pose_tracker import PoseRecord
from sitl.world.quadrotor import GRAVITY_MPS2, Quadrotor

TURN_S = 1.0 / 60.0


def record(stamp_s: float, x: float = 0.0, yaw_deg: float = 0.0) -> PoseRecord:
    quat = np.array(from_yaw(math.radians(yaw_deg)))
    return PoseRecord(stamp_s, np.array([x, 2.0, 1.0]), quat, np.full(6, 1e-4), 100, 3)


def context(world: Any) -> InjectionContext:
    return InjectionContext(cast("Any", SimpleNamespace(**world)), random.Random(1))


def moving(velocity: tuple[float, float, float]) -> InjectionContext:
    truth = SimpleNamespace(velocity=velocity)
    return context({"flyer": SimpleNamespace(truth=lambda: truth)})


@pytest.mark.parametrize(("share", "expected_m"), [(0.0, 1.0), (1.0, 1.4)])
def test_a_translation_stands_still_or_coasts_and_is_right_again_at_once(share: float, expected_m: float) -> None:
    fault = pose_stream.CoastingPoses(2.0, share)
    fault.begin(moving((0.4, 0.0, 0.0)))
    fault.pose(0.0, record(10.0, 1.0))
    ((wait_s, seen),) = fault.pose(1.0, record(11.0, 7.0, yaw_deg=30.0))
    assert wait_s == 0.0
    np.testing.assert_allclose(seen.position_m, [expected_m, 2.0, 1.0])
    assert yaw_of(tuple(seen.quat_wxyz)) == pytest.approx(math.radians(30.0))
    np.testing.assert_array_equal(seen.variance, np.full(6, 1e-4))
    assert fault.pose(2.0, record(12.0, 8.0))[0][1].position_m[0] == 8.0


@pytest.mark.parametrize("counted", [False, True])
def test_a_restarted_source_begins_at_the_vehicle(counted: bool) -> None:
    fault = pose_stream.RestartedSource(counted)
    (_, first) = fault.pose(0.0, record(10.0, 5.0, yaw_deg=90.0))[0]
    np.testing.assert_allclose(first.position_m, np.zeros(3), atol=1e-12)
    assert yaw_of(tuple(first.quat_wxyz)) == pytest.approx(0.0)
    ahead = dataclasses.replace(record(11.0, 5.0, yaw_deg=120.0), position_m=np.array([5.0, 3.0, 1.2]))
    (_, later) = fault.pose(1.0, ahead)[0]
    np.testing.assert_allclose(later.position_m, [1.0, 0.0, 0.2], atol=1e-12)
    assert yaw_of(tuple(later.quat_wxyz)) == pytest.approx(math.radians(30.0))
    assert later.reset_counter == (4 if counted else 3)


def test_what_the_source_claims_is_changed_from_boot_on_beside_the_fault() -> None:
    assert standing_conditions(None) == []
    written: list[PoseRecord] = []
    stream = SimpleNamespace(write_pose=lambda *values: written.append(PoseRecord(*values)))
    world: Any = SimpleNamespace(stream=stream)
    fault = Fault("H1c", [pose_stream.AlteredPoses(pose_stream.moved(x=1.0))])
    director = FaultDirector([fault], seed=1, conditions=standing_conditions(0.05))
    director.enter(world, None, 0.0)
    pose = record(1.0)
    values = (pose.stamp_s, pose.position_m, pose.quat_wxyz, pose.variance, pose.quality, pose.reset_counter)
    world.stream.write_pose(*values)
    director._begin_fault(fault, 0.0)
    world.stream.write_pose(*values)
    assert [each.position_m[0] for each in written] == [0.0, 1.0]
    for each in written:
        np.testing.assert_allclose(each.variance, [*[0.0025] * 3, *[1e-4] * 3])


def test_a_gyro_is_off_or_clips() -> None:
    sample, rng = StreamedImuSample(1.0, np.array([0.1, -9.0, 9.0]), np.array([0.0, 0.0, 9.8])), np.random.default_rng(1)
    np.testing.assert_allclose(inertial_sensor.offset_gyro(y=0.05)(sample, rng).gyro_radps, [0.1, -8.95, 9.0])
    clipped = inertial_sensor.clipped_gyro(250.0)(sample, rng)
    np.testing.assert_allclose(np.degrees(clipped.gyro_radps), [math.degrees(0.1), -250.0, 250.0])
    np.testing.assert_array_equal(clipped.specific_force_mps2, sample.specific_force_mps2)


def frame(range_mm: int) -> DepthFrame:
    spec = FAST_DEPTH_SPEC
    return DepthFrame(10.0, np.full((spec.height, spec.width), range_mm, np.uint16), np.zeros((2, 3, 3), np.uint8))


def test_every_fifth_frame_is_changed() -> None:
    fault = depth_camera.EveryNthFrame(depth_camera.constant(0), 5)
    empty = [not fault.depth(n / 6, frame(3000))[0][1].depth_mm.any() for n in range(12)]
    assert [n for n, each in enumerate(empty) if each] == [0, 5, 10]


def test_a_false_wall_has_its_size_and_range_and_hides_only_what_is_behind() -> None:
    change, rng = depth_camera.false_wall(1.0, 1.2), np.random.default_rng(1)
    seen = change(frame(3000).depth_mm, rng) == 1200
    rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    assert seen.sum() == len(rows) * len(columns)
    assert len(rows) * 1.2 / FAST_DEPTH_SPEC.fy == pytest.approx(1.0, abs=0.03)
    assert len(columns) * 1.2 / FAST_DEPTH_SPEC.fx == pytest.approx(1.0, abs=0.03)
    assert (change(frame(1000).depth_mm, rng) == 1000).all()
    assert (change(frame(0).depth_mm, rng) == 1200).any()


def test_a_heading_is_off_at_once_or_turns_away_and_the_time_is_noted() -> None:
    estimator = SimpleNamespace(heading_error_rad=0.0)
    at = context({"autopilot": SimpleNamespace(estimator=estimator)})
    turning: Injector = HeadingError(rate_degps=3.0)
    for since_s, off_deg in ((0.0, 0.0), (3.0, 9.0), (4.0, 12.0), (5.0, 15.0)):
        at.now_s = 100.0 + since_s
        turning.turn(at, since_s)
        assert math.degrees(estimator.heading_error_rad) == pytest.approx(off_deg)
        assert (HEADING_OFF in at.notes) is (since_s >= 4.0)
    assert at.notes[HEADING_OFF] == 104.0
    HeadingError(offset_deg=180.0).turn(at, 0.0)
    assert estimator.heading_error_rad == pytest.approx(math.pi)


@pytest.mark.parametrize("step_s", [TURN_S, TURN_S / 4])
def test_a_propeller_touch_tilts_and_pushes_once(step_s: float) -> None:
    vehicle = Quadrotor(0, wind_mps=0.0)
    vehicle.position = (0.0, 0.8, 5.0)
    at, touch = context({"autopilot": SimpleNamespace(vehicle=vehicle)}), PropellerTouch(10.0, 60.0, 0.01)
    turned_rad = 0.0
    for turn in range(3):
        touch.turn(at, turn * TURN_S)
        for _ in range(round(TURN_S / step_s)):
            vehicle.step(step_s, (0.0, 0.0, GRAVITY_MPS2), 0.0, True)
        if turn == 0:
            turned_rad = vehicle.gyro[0] * step_s * round(TURN_S / step_s)
            assert vehicle.velocity[1] == pytest.approx(-0.6, abs=0.05), "away from the wall at y > 0"
    assert math.degrees(turned_rad) == pytest.approx(-10.0, abs=1.5), "towards the wall"
    assert vehicle.external_turn_rate_radps == (0.0, 0.0, 0.0)
    assert vehicle.external_acceleration_mps2 == (0.0, 0.0, 0.0)
