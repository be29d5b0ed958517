"""Flow and range in the simulated autopilots: their messages, and what the estimate does with them without poses."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from ardupilot_rig import FOLLOWING, INTERVAL, Copilot, copter
from ardupilot_rig import flying as copter_flying
from px4_rig import flying as px4_flying
from pymavlink.dialects.v20 import common as mavlink
from scripted_companion import LAND, Companion

from sitl.autopilots.flow_aiding import FlowTuning, Terrain, flow_velocity
from sitl.autopilots.flow_parameters import flow_parameters, set_parameters
from sitl.geometry.quaternion import IDENTITY, from_euler, from_yaw
from sitl.scene.scene import Scene
from sitl.world.flow_sensor import FLOW_MOUNT_M, FlowMeasurement, FlowSensorErrors, SimulatedFlowModule
from sitl.world.range_finder import SimulatedUpwardRangeFinder

FACES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
FLOOR_Z = -0.1
DOWN, UP = 25, 24
FOR_PX4: Any = flow_parameters("px4")
FOR_ARDUPILOT: Any = flow_parameters("ardupilot")


def sheets(*heights_m: float) -> Scene:
    """Return a scene of level sheets 40 m wide."""
    square = np.array([(-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0)], np.float32)
    vertices = np.concatenate([np.column_stack([square, np.full(4, z, np.float32)]) for z in heights_m])
    faces = np.concatenate([FACES + 4 * i for i in range(len(heights_m))]).astype(np.int32)
    grey = np.full((len(vertices), 3), 128, np.uint8)
    return Scene("sheets", vertices, faces, grey, 0.0, np.full(3, -9.0), np.full(3, 9.0), np.zeros(3))


def floor(errors: FlowSensorErrors | None = None) -> SimulatedFlowModule:
    return SimulatedFlowModule(sheets(FLOOR_Z), 3, errors)


# -- one measurement ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("flow", "gyro", "yaw_rad", "expected"),
    [
        ((0.0, 0.05), (0.0, 0.0, 0.0), 0.0, (1.2, 0.0)),  # flow about y: forward
        ((-0.05, 0.0), (0.0, 0.0, 0.0), 0.0, (0.0, 1.2)),  # flow about x: to the left if positive
        ((0.0, 0.05), (0.0, 0.0, 0.0), math.pi / 2, (0.0, 1.2)),
        ((0.04, 0.03), (0.04, 0.03, 0.0), 0.0, (0.0, 0.0)),  # a turn alone
    ],
)
def test_a_flow_of_one_radian_per_second_at_1_2_metres_is_1_2_metres_per_second(
    flow: tuple[float, float], gyro: tuple[float, float, float], yaw_rad: float, expected: tuple[float, float]
) -> None:
    measured = FlowMeasurement(0.0, 0.05, flow, gyro, 200)
    north, east, distance_m = flow_velocity(measured, (0.0, 0.0, 0.0), 1.2, from_yaw(yaw_rad), (0.0, 0.0, 0.0))
    assert (north, east) == pytest.approx(expected, abs=1e-9)
    assert distance_m == pytest.approx(1.2)


def test_the_turn_of_the_lever_arm_is_no_motion_of_the_body() -> None:
    """A sensor 0.1 m ahead moves 0.2 m/s to the right in a turn of 2 rad/s: flow -0.2 / 1.2 about x."""
    measured = FlowMeasurement(0.0, 0.05, (-0.05 * 0.2 / 1.2, 0.0), (0.0, 0.0, 0.1), 200)
    north, east, _ = flow_velocity(measured, (0.1, 0.0, 0.0), 1.2, IDENTITY, (0.0, 0.0, 0.0))
    assert (north, east) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_the_terrain_is_below_the_body_and_follows_its_descent() -> None:
    terrain = Terrain()
    assert math.isnan(terrain.height_m(0.0, 0.0))
    terrain.measure(1.0, 1.2, IDENTITY, (0.0, 0.0, 0.03), 0.0)
    assert terrain.height_m(1.0, 0.0) == pytest.approx(1.23)
    assert terrain.height_m(1.2, 0.5) == pytest.approx(1.13)
    leaning = Terrain()
    leaning.measure(1.0, 1.2 / math.cos(0.4), from_euler(0.4, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
    assert leaning.height_m(1.0, 0.0) == pytest.approx(1.2)
    leaning.measure(9.0, 0.3, from_euler(1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
    assert leaning.measured_s == 1.0, "at a tilt of 57 degrees it measures no height"


def test_the_noise_grows_as_the_quality_falls() -> None:
    tuning = FlowTuning(noise_radps=(0.15, 0.5), quality_min=1)
    assert [tuning.noise(q) for q in (255, 128, 1, 0)] == pytest.approx([0.15, 0.325, 0.5, 0.5])


# -- messages -------------------------------------------------------------------------------------------------------


def told(c: Any, *kinds: str, rate_hz: float | None = None) -> list[Any]:
    """Return the messages of two seconds, requested at a rate."""
    c.keep = set(kinds)
    ids = {"DISTANCE_SENSOR": 132, "OPTICAL_FLOW_RAD": 106, "OPTICAL_FLOW": 100}
    for kind in kinds if rate_hz is not None else ():
        c.command(INTERVAL, ids[kind], 1e6 / (rate_hz or 1.0))
    c.run(2.0)
    return list(c.messages)


def lifted(c: Any, errors: FlowSensorErrors, height_m: float = 1.0) -> Any:
    """Return the vehicle held at a height, moving at 0.5 m/s to the north; only its sensors run."""
    c.autopilot.mount_flow_module(floor(errors))
    step, north = c.vehicle.step, 0.0

    def held(dt_s: float, *rest: Any) -> None:
        nonlocal north
        north += 0.5 * dt_s
        step(dt_s, *rest)
        c.vehicle.position, c.vehicle.velocity = (0.0, north, height_m), (0.0, 0.5, 0.0)

    c.vehicle.step = held
    c.run(0.6)
    return c


def test_px4_streams_each_flow_once_as_angles_over_its_interval() -> None:
    c = lifted(Companion(yaw_rad=math.pi / 2), replace(FlowSensorErrors(), rate_hz=20.0, delay_s=0.02))  # heading north
    messages = told(c, "OPTICAL_FLOW_RAD", rate_hz=50.0)
    assert 38 <= len(messages) <= 41
    assert len({m.time_usec for m in messages}) == len(messages)
    one = messages[-1]
    dt = one.integration_time_us * 1e-6
    range_m = 1.0 - FLOOR_Z + FLOW_MOUNT_M[2]
    assert dt == pytest.approx(0.05, abs=0.005)
    assert (one.integrated_x / dt, one.integrated_y / dt) == pytest.approx((0.0, 0.5 / range_m), abs=0.01)
    assert (one.integrated_xgyro, one.integrated_ygyro, one.integrated_zgyro) == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
    assert one.distance == pytest.approx(range_m, abs=0.06)
    assert (one.sensor_id, one.temperature, one.time_delta_distance_us) == (0, 0, 0)
    assert 0 < one.quality <= 255


def test_px4_streams_flow_at_10_hertz_unasked_and_none_without_a_sensor() -> None:
    assert 18 <= len(told(lifted(Companion(), FlowSensorErrors()), "OPTICAL_FLOW_RAD")) <= 21
    assert told(Companion(), "OPTICAL_FLOW_RAD", "DISTANCE_SENSOR", rate_hz=50.0) == []


def test_px4_marks_a_range_out_of_limits_and_the_flow_has_no_distance() -> None:
    messages = told(lifted(Companion(), FlowSensorErrors(), 6.0), "OPTICAL_FLOW_RAD", "DISTANCE_SENSOR", rate_hz=50.0)
    down = [m for m in messages if m.get_type() == "DISTANCE_SENSOR"]
    assert {(m.orientation, m.current_distance, m.signal_quality, m.id) for m in down} == {(DOWN, 400, 1, 0)}
    assert {m.distance for m in messages if m.get_type() == "OPTICAL_FLOW_RAD"} == {-1.0}


@pytest.mark.parametrize("make", [Companion, lambda: copter(**FOR_ARDUPILOT)])
def test_range_finders_up_and_down_have_ids_of_their_own(make: Any) -> None:
    c = lifted(make(), FlowSensorErrors())
    c.autopilot.mount_range_finder(SimulatedUpwardRangeFinder(sheets(2.5), 1, 0.4))
    messages = told(c, "DISTANCE_SENSOR", rate_hz=50.0)
    assert {(m.orientation, m.id, m.signal_quality) for m in messages} == {(UP, 0, 0), (DOWN, 1, 0)}
    down = [m for m in messages if m.orientation == DOWN]
    assert [m.current_distance for m in down] == pytest.approx([107.0] * len(down), abs=6.0)
    assert {(m.min_distance, m.max_distance) for m in down} == {(5, 400)}


def test_ardupilot_sends_the_newest_flow_as_a_rate_on_request() -> None:
    assert told(lifted(copter(**FOR_ARDUPILOT), FlowSensorErrors()), "OPTICAL_FLOW") == []
    c = lifted(
        Copilot(copter(**FOR_ARDUPILOT).copter.parameters, yaw_rad=math.pi / 2),
        replace(FlowSensorErrors(), gyro_bias_radps=(0.2, -0.1, 0.0)),
    )
    messages = told(c, "OPTICAL_FLOW", rate_hz=50.0)
    assert len(messages) > 80
    assert len({m.flow_rate_y for m in messages}) < 45, "the newest is repeated"
    one = messages[-1]
    flow = 0.5 / (1.0 - FLOOR_Z + FLOW_MOUNT_M[2])
    assert (one.flow_rate_x, one.flow_rate_y) == pytest.approx((0.0, flow), abs=0.01)
    assert (one.flow_comp_m_x, one.flow_comp_m_y) == pytest.approx((-0.2, flow + 0.1), abs=0.02), "flow minus turn, rad/s"
    assert (one.flow_x, one.flow_y) == (0, 0), "whole rad/s"
    assert one.time_usec == pytest.approx((c.now_s - c.autopilot.boot_s) * 1e3, abs=50.0), "milliseconds, of the sending"


def test_ardupilot_reads_no_sensor_that_its_parameters_do_not_name() -> None:
    assert told(lifted(copter(), FlowSensorErrors()), "OPTICAL_FLOW", "DISTANCE_SENSOR", rate_hz=50.0) == []


def test_ardupilot_sends_no_range_that_has_no_data() -> None:
    far = lifted(copter(**FOR_ARDUPILOT), FlowSensorErrors(), 6.0)
    assert told(far, "DISTANCE_SENSOR", rate_hz=50.0) == []


# -- without poses --------------------------------------------------------------------------------------------------


def px4_up(seed: int = 1, **changes: float) -> Companion:
    """Return a hovering PX4 with the module."""
    c = px4_flying(seed)
    set_parameters(c.px4.parameters, {**FOR_PX4, **changes})
    c.autopilot.mount_flow_module(floor())
    c.run(2.0)
    return c


def copter_up(seed: int = 1, **changes: float) -> Copilot:
    """Return a hovering ArduCopter with the module."""
    c = copter_flying(seed, **FOR_ARDUPILOT, **changes)
    c.autopilot.mount_flow_module(floor())
    c.run(2.0)
    return c


def speed(c: Any) -> float:
    return math.hypot(*c.vehicle.velocity[:2])


def drift_m(c: Any, seconds: float) -> float:
    """Return the way (m) of the vehicle from here, horizontally, without poses."""
    x, y, _ = c.vehicle.position
    c.pose_on = False
    c.run(seconds)
    return math.hypot(c.vehicle.position[0] - x, c.vehicle.position[1] - y)


def test_px4_holds_its_velocity_on_flow_alone() -> None:
    c = px4_up()
    assert drift_m(c, 20.0) < 1.0
    assert c.autopilot.estimator.horizontal_valid
    assert c.autopilot.estimator.flow_fused
    assert c.flags & 2
    assert speed(c) < 0.2
    assert c.autopilot.failsafes == []
    n = c.autopilot.estimator.velocity
    assert math.hypot(n[0] - c.vehicle.velocity[1], n[1] - c.vehicle.velocity[0]) < 0.12


@pytest.mark.parametrize("changes", [{"EKF2_OF_CTRL": 0}, {"EKF2_OF_QMIN": 255}])
def test_px4_loses_its_position_where_the_flow_is_not_fused(changes: dict[str, Any]) -> None:
    c = px4_up(**changes)
    drift_m(c, 6.0)
    assert not c.autopilot.estimator.flow_fused
    assert not c.autopilot.estimator.horizontal_valid
    assert c.autopilot.failsafes


def test_px4_lands_with_its_velocity_known() -> None:
    with_flow, without = px4_up(), px4_up(EKF2_OF_CTRL=0)
    ways = []
    for c in (with_flow, without):
        x, y, _ = c.vehicle.position
        c.pose_on = False
        c.vehicle.push((0.3, 0.0, 0.0))
        c.run(0.5)
        c.set_mode(LAND)
        c.run(12.0)
        assert c.vehicle.on_ground
        ways.append(math.hypot(c.vehicle.position[0] - x, c.vehicle.position[1] - y))
    assert ways[0] < 0.5


def test_ardupilot_keeps_the_relative_position_and_loses_the_absolute_one() -> None:
    c = copter_up()
    assert c.flags == FOLLOWING | 64, "with a range finder it knows the height above ground"
    assert drift_m(c, 20.0) < 1.5
    assert c.flags == (FOLLOWING | 64) & ~16 & ~512
    assert c.autopilot.failsafes == []
    assert c.copter.truth().mode == "GUIDED"


@pytest.mark.parametrize("changes", [{"EK3_SRC_OPTIONS": 0}, {"EK3_FLOW_USE": 0}, {"EK3_SRC2_VELXY": 0}])
def test_ardupilot_keeps_the_flags_for_15_seconds_of_flow_that_is_not_fused(changes: dict[str, float]) -> None:
    c = copter_up()
    set_parameters(c.copter.parameters, changes)
    c.run(1.0)
    drift_m(c, 12.0)
    assert c.flags & 8
    assert not c.autopilot.estimator.flow_fused
    c.run(4.5)
    assert not c.flags & 8
    assert c.autopilot.failsafes == ["EKF Failsafe: LAND"]


def test_ardupilot_sends_its_height_above_ground_with_the_flow_0_if_it_has_none() -> None:
    c = copter_up()
    assert told(c, "OPTICAL_FLOW", rate_hz=20.0)[-1].ground_distance == pytest.approx(c.vehicle.position[2] - FLOOR_Z, abs=0.05)
    set_parameters(c.copter.parameters, {"RNGFND1_TYPE": 0})
    c.run(6.0)
    assert c.last["OPTICAL_FLOW"].ground_distance == 0.0


def test_ardupilot_falls_back_a_second_after_the_flow_ends() -> None:
    c = copter_up()
    drift_m(c, 10.0)
    module = c.autopilot._board.flow_module
    assert module is not None
    module.light = 0.0
    assert c.flags & 8
    c.run(1.5)
    assert not c.flags & 8


def test_poses_that_return_are_followed_again() -> None:
    c = px4_up()
    drift_m(c, 10.0)
    c.pose_on = True
    c.run(6.0)
    n = c.autopilot.estimator.position
    assert math.hypot(n[0] - c.ned[0], n[1] - c.ned[1]) < 0.05


def test_in_the_air_flow_beside_good_poses_changes_the_estimate_by_little() -> None:
    c = px4_up()
    c.setpoint = lambda t: (1.5 * math.sin(0.6 * t), 0.0, -1.2, *[math.nan] * 6, 0.0, 0.0)
    worst = 0.0
    for _ in range(60):
        c.run(0.2)
        n = c.autopilot.estimator.position
        worst = max(worst, math.hypot(n[0] - c.ned[0], n[1] - c.ned[1]))
    assert worst < 0.04


def test_a_mounted_module_is_off_unless_the_parameters_say_so() -> None:
    c = px4_flying(1)
    c.autopilot.mount_flow_module(floor())
    drift_m(c, 1.0)
    assert not c.autopilot.estimator.flow_tuning.fuse
    assert not c.autopilot.estimator.flow_fused
    assert mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW_RAD == 106
