"""Parameters that a user of the flow module sets, in addition to those of firmware_params/."""

from __future__ import annotations

from collections.abc import Mapping

from sitl.autopilots.parameter_table import ParameterTable
from sitl.geometry.ned_frd import frd_from_flu
from sitl.world.flow_sensor import FLOW_MOUNT_M, RANGE_M, RANGE_MOUNT_M

_AXES = ("X", "Y", "Z")
_MSP_FLOW = 7  # FLOW_TYPE
_MSP_RANGE = 32  # RNGFND1_TYPE
_OPTICAL_FLOW = 5  # EK3_SRC2_VELXY
_FUSE_ALL_VELOCITIES = 1  # EK3_SRC_OPTIONS
_LOOKS_DOWN = 25  # RNGFND1_ORIENT


def flow_parameters(autopilot: str) -> dict[str, float]:
    """Return name and value of each parameter for the flow module. autopilot: px4 or ardupilot."""
    if autopilot == "ardupilot":
        return {
            "FLOW_TYPE": _MSP_FLOW,
            "EK3_SRC2_VELXY": _OPTICAL_FLOW,
            "EK3_SRC_OPTIONS": _FUSE_ALL_VELOCITIES,
            "RNGFND1_TYPE": _MSP_RANGE,
            "RNGFND1_ORIENT": _LOOKS_DOWN,
            "RNGFND1_MIN": RANGE_M[0],
            "RNGFND1_MAX": RANGE_M[1],
            **_positions("FLOW_POS_", "RNGFND1_POS_"),
        }
    return {
        "EKF2_OF_CTRL": 1,
        "EKF2_RNG_A_HMAX": 0.0,
        "EKF2_RNG_CTRL": 1,
        "SENS_FLOW_MAXHGT": RANGE_M[1],
        **_positions("EKF2_OF_POS_", "EKF2_RNG_POS_"),
    }


def set_parameters(table: ParameterTable, values: Mapping[str, float]) -> None:
    """Set these parameters. Raises KeyError for an unknown name."""
    for name, value in values.items():
        table.set(name, value)


def _positions(flow: str, distance: str) -> dict[str, float]:
    """Return the positions of both sensors on the body, FRD, under these prefixes."""
    mounts = ((flow, FLOW_MOUNT_M), (distance, RANGE_MOUNT_M))
    return {f"{prefix}{axis}": m for prefix, mount in mounts for axis, m in zip(_AXES, frd_from_flu(mount), strict=True)}
