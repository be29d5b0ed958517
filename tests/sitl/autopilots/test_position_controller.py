from __future__ import annotations

import math

import pytest

from sitl.autopilots.position_controller import ControlSetpoint, PositionController
from sitl.autopilots.px4.parameters import Px4Parameters
from sitl.autopilots.px4.tuning import control_gains
from sitl.world.quadrotor import GRAVITY_MPS2

DT = 0.004
STILL = (0.0, 0.0, 0.0)


def controller(**changes: float) -> PositionController:
    p = Px4Parameters.load()
    for name, value in changes.items():
        p.set(name, value)
    return PositionController(control_gains(p))


def once(
    c: PositionController, setpoint: ControlSetpoint, **state: tuple[float, float, float]
) -> tuple[tuple[float, ...], float]:
    position, velocity = state.get("position", STILL), state.get("velocity", STILL)
    return c.step(DT, position, velocity, STILL, 0.0, setpoint)


def test_at_the_setpoint_the_thrust_equals_the_weight() -> None:
    force, turn = once(controller(), ControlSetpoint(position=STILL, yaw=0.0))
    assert force == pytest.approx((0.0, 0.0, -GRAVITY_MPS2))
    assert turn == 0.0


def test_gains_come_from_the_parameters() -> None:
    force, _ = once(controller(MPC_XY_P=1.0, MPC_XY_VEL_P_ACC=2.0), ControlSetpoint(position=(0.3, 0.0, 0.0)))
    assert force[0] == pytest.approx(0.6)
    force, _ = once(controller(MPC_Z_P=1.0, MPC_Z_VEL_P_ACC=4.0), ControlSetpoint(position=(0.0, 0.0, -0.1)))
    assert force[2] == pytest.approx(-0.4 - GRAVITY_MPS2)


def test_a_far_setpoint_is_flown_no_faster_than_the_limit() -> None:
    c = controller(MPC_XY_VEL_MAX=1.2)
    at_limit, _ = once(c, ControlSetpoint(position=(30.0, 40.0, 0.0)), velocity=(0.72, 0.96, 0.0))
    assert at_limit[:2] == pytest.approx((0.0, 0.0), abs=1e-6)  # parameters are 32-bit floats


def test_only_the_tilt_limits_the_acceleration() -> None:
    hard = ControlSetpoint(acceleration=(9.0, 0.0, 0.0))
    force, _ = once(controller(MPC_ACC_HOR_MAX=2.0, MPC_ACC_HOR=2.0, MPC_TILTMAX_AIR=20.0), hard)
    assert math.degrees(math.atan2(force[0], -force[2])) == pytest.approx(20.0)


def test_climb_and_descent_have_their_own_limits() -> None:
    c = controller(MPC_Z_VEL_MAX_UP=0.7, MPC_Z_VEL_MAX_DN=0.5)
    up, _ = once(c, ControlSetpoint(position=(0.0, 0.0, -9.0)), velocity=(0.0, 0.0, -0.7))
    assert up[2] == pytest.approx(-GRAVITY_MPS2, abs=1e-6)
    down, _ = once(controller(), ControlSetpoint(position=(0.0, 0.0, 9.0)), velocity=(0.0, 0.0, 0.5))
    assert down[2] == pytest.approx(-GRAVITY_MPS2, abs=1e-6)
    ramp = controller().step(DT, STILL, (0.0, 0.0, -0.2), STILL, 0.0, ControlSetpoint(position=(0.0, 0.0, -9.0)), 0.2)
    assert ramp[0][2] == pytest.approx(-GRAVITY_MPS2, abs=1e-6)


def test_feedforward_is_added_to_the_controlled_axes() -> None:
    force, turn = once(
        controller(), ControlSetpoint(STILL, (0.5, 0.0, 0.0), (0.25, 0.0, 0.0), 0.0, 0.3), velocity=(0.5, 0.0, 0.0)
    )
    assert force[0] == pytest.approx(0.25)
    assert turn == pytest.approx(0.3)


def test_an_ignored_yaw_causes_no_turn() -> None:
    _, turn = once(controller(), ControlSetpoint(position=STILL))
    assert turn == 0.0
    _, turn = once(controller(), ControlSetpoint(position=STILL, yaw=3.0))
    assert turn == pytest.approx(math.radians(90.0))  # MPC_YAWRAUTO_MAX


def test_velocity_only_and_acceleration_only_are_flown() -> None:
    force, _ = once(controller(), ControlSetpoint(velocity=(0.5, 0.0, 0.0)))
    assert force[0] == pytest.approx(0.9)
    force, _ = once(controller(), ControlSetpoint(acceleration=(0.5, 0.0, 0.0)))
    assert force[0] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("setpoint", "valid"),
    [
        (ControlSetpoint(), False),
        (ControlSetpoint(position=STILL), True),
        (ControlSetpoint(position=(0.0, math.nan, 0.0)), False),
        (ControlSetpoint(position=(0.0, 0.0, math.nan)), False),
        (ControlSetpoint(position=(0.0, 0.0, math.nan), velocity=(math.nan, math.nan, 0.2)), True),
        (ControlSetpoint(velocity=(0.0, 0.0, 0.0), yaw=math.nan), True),
    ],
)
def test_every_axis_needs_a_setpoint(setpoint: ControlSetpoint, valid: bool) -> None:
    assert setpoint.valid is valid


def test_the_integral_does_not_wind_up_against_a_limit() -> None:
    c = controller(MPC_TILTMAX_AIR=12.0)
    far = ControlSetpoint(position=(9.0, 0.0, 0.0))
    for _ in range(2500):
        once(c, far)
    force, _ = once(c, ControlSetpoint(position=STILL))
    assert abs(force[0]) < 0.1


def test_a_held_setpoint_shifts_with_a_jump_of_the_estimate() -> None:
    moved = ControlSetpoint(position=(1.0, 2.0, -1.0), yaw=0.1).shifted((0.5, 0.0, -0.1), 0.2)
    assert moved.position == pytest.approx((1.5, 2.0, -1.1))
    assert moved.yaw == pytest.approx(0.3)


def test_without_a_position_the_vehicle_stays_level() -> None:
    force = controller().level(DT, velocity_down=0.0, wanted_down=0.35)
    assert force[:2] == (0.0, 0.0)
    assert force[2] > -GRAVITY_MPS2
