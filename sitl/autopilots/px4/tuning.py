"""Conversion of PX4's parameters to tunings of the estimator and the position controller."""

from __future__ import annotations

import math

from sitl.autopilots.ekf import EstimatorTuning
from sitl.autopilots.flow_aiding import FlowTuning
from sitl.autopilots.position_controller import ControlGains
from sitl.autopilots.px4.parameters import Px4Parameters
from sitl.autopilots.px4.trajectory_smoothing import SmoothingLimits
from sitl.world.flow_sensor import FLOW_MAX_RADPS
from sitl.world.quadrotor import GRAVITY_MPS2

_REJECT_S = 1.0  # no_aid_timeout_max, after which the estimate is reset to vision
_RESETS_IN_AIR = 5


def estimator_tuning(p: Px4Parameters) -> EstimatorTuning:
    """Return the tuning of EKF2.

    Measured with EKF2_NOAID_TOUT = 5 s: the position flag is lost 4.7 s after the last pose.
    """
    control = p.integer("EKF2_EV_CTRL")
    no_aid_s = max(p["EKF2_NOAID_TOUT"], 500000.0) * 1e-6
    return EstimatorTuning(
        fuse_xy=bool(control & 1),
        fuse_z=bool(control & 2),
        fuse_yaw=bool(control & 8),
        noise_from_message=p.integer("EKF2_EV_NOISE_MD") == 0,
        position_noise_m=p["EKF2_EVP_NOISE"],
        yaw_noise_rad=p["EKF2_EVA_NOISE"],
        gate=p["EKF2_EVP_GATE"],
        quality_min=p.integer("EKF2_EV_QMIN"),
        delay_s=p["EKF2_EV_DELAY"] * 1e-3,
        valid_s=max(no_aid_s - 0.3, 0.6),
        reject_s=_REJECT_S,
        resets_in_air=_RESETS_IN_AIR,
        flow=flow_tuning(p, max(no_aid_s - 0.3, 0.6)),
    )


def flow_tuning(p: Px4Parameters, valid_s: float) -> FlowTuning:
    """Return the tuning of flow fusion. valid_s: time for which aiding keeps the velocity valid.

    From the sources: a mounted sensor is read and streamed whatever EKF2_OF_CTRL is (optical_flow_control.cpp); flow that is
    fused ends dead reckoning, so the local position remains valid (updateHorizontalDeadReckoningstatus). EKF2_RNG_CTRL makes
    the range a source of height; here the height stays with poses or barometer, and the range gives the terrain only.
    """
    return FlowTuning(
        read=True,
        range_read=True,
        fuse=p.integer("EKF2_OF_CTRL") != 0 and p.integer("EKF2_RNG_CTRL") != 0,
        quality_min=max(p.integer("EKF2_OF_QMIN"), 1),
        noise_radps=(p["EKF2_OF_N_MIN"], p["EKF2_OF_N_MAX"]),
        gate=max(p["EKF2_OF_GATE"], 1.0),
        rate_max_radps=min(p["SENS_FLOW_MAXR"], FLOW_MAX_RADPS),
        height_m=(p["SENS_FLOW_MINHGT"], p["SENS_FLOW_MAXHGT"]),
        delay_s=p["EKF2_OF_DELAY"] * 1e-3,
        position_m=(p["EKF2_OF_POS_X"], p["EKF2_OF_POS_Y"], p["EKF2_OF_POS_Z"]),
        range_position_m=(p["EKF2_RNG_POS_X"], p["EKF2_RNG_POS_Y"], p["EKF2_RNG_POS_Z"]),
        valid_s=valid_s,
        reset_s=_REJECT_S,
    )


def control_gains(p: Px4Parameters) -> ControlGains:
    """Return the gains of mc_pos_control.

    Acceleration is limited by tilt and thrust only, not by a parameter (from the sources).
    """
    hover = p["MPC_THR_HOVER"]
    return ControlGains(
        xy_p=p["MPC_XY_P"],
        z_p=p["MPC_Z_P"],
        yaw_p=p["MC_YAW_P"],
        xy_velocity=(p["MPC_XY_VEL_P_ACC"], p["MPC_XY_VEL_I_ACC"], p["MPC_XY_VEL_D_ACC"]),
        z_velocity=(p["MPC_Z_VEL_P_ACC"], p["MPC_Z_VEL_I_ACC"], p["MPC_Z_VEL_D_ACC"]),
        speed_xy=p["MPC_XY_VEL_MAX"],
        speed_up=p["MPC_Z_VEL_MAX_UP"],
        speed_down=p["MPC_Z_VEL_MAX_DN"],
        accel_up=GRAVITY_MPS2 * (p["MPC_THR_MAX"] / hover - 1.0),
        accel_down=GRAVITY_MPS2 * (1.0 - p["MPC_THR_MIN"] / hover),
        tilt_rad=math.radians(p["MPC_TILTMAX_AIR"]),
        yaw_rate=math.radians(p["MPC_YAWRAUTO_MAX"]),
    )


def smoothing_limits(p: Px4Parameters) -> tuple[SmoothingLimits, SmoothingLimits, SmoothingLimits]:
    """Return the limits of FlightTaskAuto: horizontal, upwards, downwards."""
    jerk = p["MPC_JERK_AUTO"]
    return (
        SmoothingLimits(min(p["MPC_XY_CRUISE"], p["MPC_XY_VEL_MAX"]), p["MPC_ACC_HOR"], jerk),
        SmoothingLimits(p["MPC_Z_V_AUTO_UP"], p["MPC_ACC_UP_MAX"], jerk),
        SmoothingLimits(p["MPC_Z_V_AUTO_DN"], p["MPC_ACC_DOWN_MAX"], jerk),
    )
