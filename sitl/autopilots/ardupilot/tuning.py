"""Conversion of ArduPilot's parameters to tunings of the estimator and the controller."""

from __future__ import annotations

import math

from sitl.autopilots.ardupilot.input_shaping import ShapingLimits
from sitl.autopilots.ardupilot.parameters import ArduPilotParameters
from sitl.autopilots.ekf import EstimatorTuning
from sitl.autopilots.flow_aiding import FlowTuning
from sitl.autopilots.position_controller import ControlGains

EXTERNAL = 6  # EK3_SRC1_*: external navigation
OPTICAL_FLOW = 5  # EK3_SRC1_VELXY
_LOOKS_DOWN = 25  # RNGFND1_ORIENT
_FUSE_ALL_VELOCITIES = 1  # EK3_SRC_OPTIONS
_FLOW_FOR_NAVIGATION = 1  # EK3_FLOW_USE
# from the sources
_TILT_AIDING_S = 15.0  # tiltDriftTimeMax_ms: without any aiding for this time, EKF3 stops aiding
_FLOW_SEEN_S = 1.0  # flowDataValid
_TERRAIN_S = 5.0  # gndOffsetValid
_FLOW_MAX_RADPS = 4.2  # of flow and turn, writeOptFlowMeas
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
        flow=flow_tuning(p),
    )


def flow_tuning(p: ArduPilotParameters) -> FlowTuning:
    """Return the tuning of flow fusion.

    From the sources (AP_NavEKF3_Control.cpp): when external poses stop, EKF3 stays in AID_ABSOLUTE; it changes to AID_RELATIVE
    from AID_NONE only. The absolute position times out. The relative one is valid while flow is read and the terrain known,
    even if flow is not fused, until nothing was fused for 15 s. Any quality above 0 is fused (writeOptFlowMeas).
    """
    return FlowTuning(
        read=p.integer("FLOW_TYPE") > 0,
        range_read=p.integer("RNGFND1_TYPE") > 0 and p.integer("RNGFND1_ORIENT") == _LOOKS_DOWN,
        fuse=p.integer("EK3_FLOW_USE") == _FLOW_FOR_NAVIGATION and _flow_is_source(p),
        noise_radps=(max(p["EK3_FLOW_M_NSE"], 0.05), max(p["EK3_FLOW_M_NSE"], 0.05)),
        gate=max(0.01 * p["EK3_FLOW_I_GATE"], 1.0),
        rate_max_radps=min(p["EK3_MAX_FLOW"], _FLOW_MAX_RADPS),
        delay_s=p["EK3_FLOW_DELAY"] * 1e-3,
        position_m=(p["FLOW_POS_X"], p["FLOW_POS_Y"], p["FLOW_POS_Z"]),
        range_position_m=(p["RNGFND1_POS_X"], p["RNGFND1_POS_Y"], p["RNGFND1_POS_Z"]),
        valid_s=_TILT_AIDING_S,
        seen_s=_FLOW_SEEN_S,
        terrain_s=_TERRAIN_S,
    )


def _flow_is_source(p: ArduPilotParameters) -> bool:
    """Return True if flow is a source of the velocity (useVelXYSource)."""
    sources = [p.integer(f"EK3_SRC{n}_VELXY") for n in (1, 2, 3)]
    return sources[0] == OPTICAL_FLOW or (bool(p.integer("EK3_SRC_OPTIONS") & _FUSE_ALL_VELOCITIES) and OPTICAL_FLOW in sources)


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
