"""ArduPilot's parameters as the estimator and the position controller take them."""

from __future__ import annotations

import math

from sitl.ardupilot_parameters import ArduPilotParameters
from sitl.control import Gains
from sitl.estimator import Tuning

EXTERNAL = 6  # EK3_SRC1_*: external navigation
_FLAGS_FALL_S = 7.2  # after the last pose (measured)
_REJECT_S = 7.0  # posRetryTimeNoVel_ms: then reset to the poses (read)
_VERTICAL_INTEGRAL = 2.0  # 1/s²: what ArduPilot's inner acceleration loop amounts to


def estimator_tuning(p: ArduPilotParameters) -> Tuning:
    """EKF3 on external navigation. Gates are in hundredths of a standard deviation."""
    fed = p.integer("VISO_TYPE") > 0
    return Tuning(
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


def control_gains(p: ArduPilotParameters) -> Gains:
    """AC_PosControl. Vertical acceleration is limited as by WP_ACC_Z, horizontal as by WP_ACC and the lean angle."""
    return Gains(
        xy_p=p["PSC_NE_POS_P"],
        z_p=p["PSC_D_POS_P"],
        yaw_p=p["ATC_ANG_YAW_P"],
        xy_velocity=(p["PSC_NE_VEL_P"], p["PSC_NE_VEL_I"], p["PSC_NE_VEL_D"]),
        z_velocity=(p["PSC_D_VEL_P"], _VERTICAL_INTEGRAL, 0.0),
        speed_xy=p["WP_SPD"],
        speed_up=p["WP_SPD_UP"],
        speed_down=p["WP_SPD_DN"],
        accel_xy=2.0 * p["WP_ACC"],  # corrections have a budget of their own, as large as the profile's
        accel_up=2.0 * p["WP_ACC_Z"],
        accel_down=2.0 * p["WP_ACC_Z"],
        tilt_rad=math.radians(p["ATC_ANGLE_MAX"]),
        yaw_rate=math.radians(p["ATC_RATE_WPY_MAX"]),
    )
