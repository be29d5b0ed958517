"""Parameters of the simulated PX4: defaults, QGroundControl file reader and wire format."""

from __future__ import annotations

import struct
from pathlib import Path

from sitl.autopilots.parameter_table import INT32, REAL32, ParameterError, ParameterTable

__all__ = ["DEFAULT_FILE", "FLOW_FILE", "INT32", "REAL32", "ParameterError", "Px4Parameters"]

# defaults of PX4 v1.17 for parameters that the simulation uses or a companion reads before arming
_DEFAULTS: dict[str, int | float] = {
    "BAT_CRIT_THR": 0.07, "BAT_EMERGEN_THR": 0.05, "BAT_LOW_THR": 0.15,
    "CBRK_FLIGHTTERM": 121212,
    "COM_DISARM_LAND": 2.0, "COM_DISARM_PRFLT": 10.0, "COM_DL_LOSS_T": 10, "COM_FAIL_ACT_T": 5.0, "COM_FLT_TIME_MAX": -1,
    "COM_LOW_BAT_ACT": 0, "COM_OBC_LOSS_T": 5.0, "COM_OBL_RC_ACT": 0, "COM_OF_LOSS_T": 1.0, "COM_POS_FS_EPH": 5.0,
    "COM_RCL_EXCEPT": 0, "COM_RC_IN_MODE": 3, "COM_RC_LOSS_T": 0.5, "COM_RC_OVERRIDE": 1, "COM_RC_STICK_OV": 30.0,
    "COM_SPOOLUP_TIME": 1.0, "COM_VEL_FS_EVH": 1.0,
    "EKF2_BARO_CTRL": 1, "EKF2_EVA_NOISE": 0.1, "EKF2_EVP_GATE": 5.0, "EKF2_EVP_NOISE": 0.1, "EKF2_EVV_GATE": 3.0,
    "EKF2_EV_CTRL": 0, "EKF2_EV_DELAY": 0.0, "EKF2_EV_NOISE_MD": 0, "EKF2_EV_POS_X": 0.0, "EKF2_EV_POS_Y": 0.0,
    "EKF2_EV_POS_Z": 0.0, "EKF2_EV_QMIN": 0, "EKF2_GPS_CTRL": 7, "EKF2_HGT_REF": 1, "EKF2_MAG_TYPE": 0,
    "EKF2_NOAID_TOUT": 5000000, "EKF2_OF_CTRL": 1, "EKF2_OF_DELAY": 20.0, "EKF2_OF_GATE": 3.0, "EKF2_OF_N_MAX": 0.5,
    "EKF2_OF_N_MIN": 0.15, "EKF2_OF_POS_X": 0.0, "EKF2_OF_POS_Y": 0.0, "EKF2_OF_POS_Z": 0.0, "EKF2_OF_QMIN": 1,
    "EKF2_RNG_A_HMAX": 5.0, "EKF2_RNG_CTRL": 1, "EKF2_RNG_POS_X": 0.0, "EKF2_RNG_POS_Y": 0.0, "EKF2_RNG_POS_Z": 0.0,
    "GF_ACTION": 2, "GF_MAX_HOR_DIST": 0.0, "GF_MAX_VER_DIST": 0.0, "GF_PREDICT": 0, "GF_SOURCE": 0,
    "LNDMC_Z_VEL_MAX": 0.25, "MAV_COMP_ID": 1, "MAV_FWDEXTSP": 1, "MAV_SYS_ID": 1, "MAV_TYPE": 2,
    "MC_YAW_P": 2.8,
    "MIS_TAKEOFF_ALT": 2.5, "MNT_MODE_IN": -1, "MNT_RANGE_PITCH": 90.0,
    "MPC_ACC_DOWN_MAX": 3.0, "MPC_ACC_HOR": 3.0, "MPC_ACC_HOR_MAX": 5.0, "MPC_ACC_UP_MAX": 4.0, "MPC_JERK_AUTO": 4.0,
    "MPC_JERK_MAX": 8.0, "MPC_LAND_ALT1": 10.0, "MPC_LAND_ALT2": 5.0, "MPC_LAND_ALT3": 1.0, "MPC_LAND_CRWL": 0.3,
    "MPC_LAND_SPEED": 0.7, "MPC_MAN_Y_MAX": 150.0, "MPC_TILTMAX_AIR": 45.0, "MPC_TILTMAX_LND": 12.0,
    "MPC_THR_HOVER": 0.5, "MPC_THR_MAX": 1.0, "MPC_THR_MIN": 0.12, "MPC_TKO_RAMP_T": 3.0, "MPC_TKO_SPEED": 1.5,
    "MPC_VEL_MANUAL": 10.0, "MPC_XY_CRUISE": 5.0, "MPC_XY_ERR_MAX": 2.0,
    "MPC_XY_P": 0.95, "MPC_XY_VEL_D_ACC": 0.2, "MPC_XY_VEL_I_ACC": 0.4, "MPC_XY_VEL_MAX": 12.0, "MPC_XY_VEL_P_ACC": 1.8,
    "MPC_YAWRAUTO_MAX": 60.0, "MPC_Z_P": 1.0, "MPC_Z_VEL_D_ACC": 0.0, "MPC_Z_VEL_I_ACC": 2.0, "MPC_Z_VEL_MAX_DN": 1.5,
    "MPC_Z_VEL_MAX_UP": 3.0, "MPC_Z_VEL_P_ACC": 4.0, "MPC_Z_V_AUTO_DN": 1.5, "MPC_Z_V_AUTO_UP": 3.0,
    "NAV_DLL_ACT": 0, "NAV_RCL_ACT": 2,
    "RTL_CONE_ANG": 45, "RTL_DESCEND_ALT": 30.0, "RTL_MIN_DIST": 10.0, "RTL_RETURN_ALT": 60.0,
    "SDLOG_PROFILE": 1, "SENS_FLOW_MAXHGT": 100.0, "SENS_FLOW_MAXR": 8.0, "SENS_FLOW_MINHGT": 0.08,
    "SYS_AUTOSTART": 4001, "SYS_FAILURE_EN": 0, "SYS_HAS_GPS": 1, "SYS_HAS_MAG": 1,
}  # fmt: skip

DEFAULT_FILE = Path(__file__).resolve().parents[3] / "firmware_params" / "px4_indoor.params"
FLOW_FILE = DEFAULT_FILE.with_name("px4_flow.params")  # in addition, with a flow module


class Px4Parameters(ParameterTable):
    """Parameter table of PX4."""

    def __init__(self) -> None:
        super().__init__(_DEFAULTS)

    @staticmethod
    def load(path: Path = DEFAULT_FILE) -> Px4Parameters:
        """Return the defaults with the values of a file.

        Raises ParameterError for an unknown name, an invalid line or an invalid value.
        """
        parameters = Px4Parameters()
        parameters._read(path, parameters._take_line)
        return parameters

    def _take_line(self, line: str) -> None:
        fields = line.split("\t")
        if len(fields) != 5:
            raise ValueError(f"expected five fields separated by tabs, got {len(fields)}")
        _, _, name, value, kind = fields
        if name not in self._values:
            raise ValueError(f"unknown parameter {name}")
        if int(kind) != self.kind(name):
            raise ValueError(f"{name} has type {self.kind(name)}, not {kind}")
        self.set(name, int(value) if self.kind(name) == INT32 else float(value))

    def on_wire(self, name: str) -> float:
        """Return the float of PARAM_VALUE: PX4 puts the BYTES of an INT32 into it, not its value."""
        if self.kind(name) == INT32:
            bits: float = struct.unpack("<f", struct.pack("<i", self.integer(name)))[0]
            return bits
        return self[name]

    def from_wire(self, name: str, wire: float) -> float:
        """Return the value of the float in a PARAM_SET."""
        if self.kind(name) == INT32:
            value: int = struct.unpack("<i", struct.pack("<f", wire))[0]
            return float(value)
        return wire
