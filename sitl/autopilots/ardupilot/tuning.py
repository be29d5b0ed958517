"""Conversion of ArduPilot's parameters to tunings of the estimator and the controller."""

from __future__ import annotations

import math

from sitl.autopilots.ardupilot.input_shaping import ShapingLimits
from sitl.autopilots.ardupilot.parameters import ArduPilotParameters
from sitl.autopilots.ekf import EstimatorTuning
from sitl.autopilots.position_controller import ControlGains

EXTERNAL = 6  # EK3_SRC1_*: external navigation
_FLAGS_FALL_S = 7.2  # from the last pose to the loss of the position flags (measured)
_REJECT_S = 7.0  # posRetryTimeNoVel_ms, after which the estimate is reset to the poses (from the sources)
_RATE_LOOP_S = 0.03  # lag of rate controller and motors (total measured: 0.09 s for ATC_INPUT_TC 0.05, 0.25 s for 0.15)
_VERTICAL_LIMIT_MPS2 = 5.0
_VERTICAL_INTEGRAL = 2.0  # 1/s²: equivalent of ArduPilot's inner acceleration loop


def estimator_tuning(p: ArduPilotParameters) -> EstimatorTuning:
    """Return the tuning of EKF3 with external navigation.

    ArduPilot's gate parameters are in hundredths of a standard deviation.
    """
    fed = p.integer("VISO_TYPE") > 0
    return EstimatorTuning(
        fuse_xy=fed and p.integer("EK3_SRC1_POSXY") == EXTERNAL,
        fuse_z=fed and p.integer("EK3_SRC1_POSZ") == EXTERNAL,
        fuse_yaw=fed and p.integer("EK3_SRC1_YAW") == EXTERNAL,
        noise_from_message=True,
        position_noise_m=p["VISO_POS_M_NSE"],
        yaw_noise_rad=p["VISO_YAW_M_NSE"],
        gate=max(0.01 * p["EK3_POS_I_GATE"], 1.0),
        quality_min=p.integer("VISO_QUAL_MIN"),
        delay_s=p["VISO_DELAY_MS"] * 1e-3,
        valid_s=_FLAGS_FALL_S,
        reject_s=_REJECT_S,
        resets_in_air=math.inf,
    )


def control_gains(p: ArduPilotParameters) -> ControlGains:
    """Return the gains of AC_PosControl after input shaping; only the lean angle is limited."""
    return ControlGains(
        xy_p=p["PSC_NE_POS_P"],
        z_p=p["PSC_D_POS_P"],
        yaw_p=p["ATC_ANG_YAW_P"],
        xy_velocity=(p["PSC_NE_VEL_P"], p["PSC_NE_VEL_I"], p["PSC_NE_VEL_D"]),
        z_velocity=(p["PSC_D_VEL_P"], _VERTICAL_INTEGRAL, 0.0),
        speed_xy=math.inf,
        speed_up=math.inf,
        speed_down=math.inf,
        accel_up=_VERTICAL_LIMIT_MPS2,
        accel_down=_VERTICAL_LIMIT_MPS2,
        tilt_rad=math.radians(p["ATC_ANGLE_MAX"]),
        yaw_rate=math.radians(p["ATC_RATE_WPY_MAX"]),
    )


def lean_lag_s(p: ArduPilotParameters) -> float:
    """Return the lag (s) of the lean angle behind the wanted acceleration.

    The attitude controller smooths its input.
    """
    return p["ATC_INPUT_TC"] + _RATE_LOOP_S


def shaping_limits(p: ArduPilotParameters) -> tuple[ShapingLimits, ShapingLimits]:
    """Return the horizontal and vertical limits of GUIDED."""
    vertical = ShapingLimits(max(p["WP_SPD_UP"], p["WP_SPD_DN"]), p["WP_ACC_Z"], p["PSC_JERK_D"])
    return ShapingLimits(p["WP_SPD"], p["WP_ACC"], p["PSC_JERK_NE"]), vertical
