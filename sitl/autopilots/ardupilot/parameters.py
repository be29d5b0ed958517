"""Parameters of the simulated ArduCopter: defaults and Mission Planner file reader."""

from __future__ import annotations

from pathlib import Path

from sitl.autopilots.parameter_table import INT32, ParameterTable

# defaults of ArduCopter 4.8-dev for parameters that the simulation uses or a companion reads before arming
_DEFAULTS: dict[str, int | float] = {
    "AHRS_EKF_TYPE": 3, "ARMING_SKIPCHK": 0, "ATC_ANGLE_MAX": 30.0, "ATC_ANG_YAW_P": 4.5, "ATC_INPUT_TC": 0.15,
    "ATC_RATE_WPY_MAX": 60.0,
    "AVOID_ENABLE": 3,
    "BATT_ARM_MAH": 0, "BATT_CAPACITY": 3300, "BATT_CRT_MAH": 0.0, "BATT_FS_CRT_ACT": 0, "BATT_FS_LOW_ACT": 0,
    "BATT_LOW_MAH": 0.0,
    "COMPASS_USE": 1, "COMPASS_USE2": 1, "COMPASS_USE3": 1,
    "DISARM_DELAY": 10,
    "EK3_ENABLE": 1, "EK3_FLOW_DELAY": 10, "EK3_FLOW_I_GATE": 300, "EK3_FLOW_M_NSE": 0.25, "EK3_FLOW_USE": 1,
    "EK3_HGT_I_GATE": 500, "EK3_MAX_FLOW": 2.5, "EK3_POS_I_GATE": 500, "EK3_SRC1_POSXY": 3, "EK3_SRC1_POSZ": 1,
    "EK3_SRC1_VELXY": 3, "EK3_SRC1_VELZ": 3, "EK3_SRC1_YAW": 1, "EK3_SRC2_VELXY": 0, "EK3_SRC3_VELXY": 0,
    "EK3_SRC_OPTIONS": 1, "EK3_VEL_I_GATE": 500,
    "FENCE_ACTION": 1, "FENCE_ALT_MAX": 100.0, "FENCE_ENABLE": 0, "FENCE_MARGIN": 2.0, "FENCE_RADIUS": 300.0,
    "FENCE_TYPE": 7, "FLOW_POS_X": 0.0, "FLOW_POS_Y": 0.0, "FLOW_POS_Z": 0.0, "FLOW_TYPE": 0,
    "FS_CRASH_CHECK": 1, "FS_DR_ENABLE": 2, "FS_DR_TIMEOUT": 30, "FS_EKF_ACTION": 1, "FS_EKF_FILT": 5.0,
    "FS_EKF_THRESH": 0.8, "FS_GCS_ENABLE": 0, "FS_GCS_TIMEOUT": 5.0, "FS_OPTIONS": 16, "FS_THR_ENABLE": 1,
    "FS_VIBE_ENABLE": 1,
    "GPS1_TYPE": 1, "GUID_OPTIONS": 0, "GUID_TIMEOUT": 3.0,
    "LAND_ALT_LOW_M": 10.0, "LAND_REPOSITION": 1, "LAND_SPD_HIGH_MS": 0.0, "LAND_SPD_MS": 0.5,
    "MAV_GCS_SYSID": 255, "MAV_GCS_SYSID_HI": 0, "MAV_OPTIONS": 0, "MAV_SYSID": 1,
    "MNT1_PITCH_MAX": 20.0, "MNT1_PITCH_MIN": -90.0, "MNT1_TYPE": 0, "MOT_SPOOL_TIME": 0.5,
    "PSC_D_POS_P": 1.0, "PSC_D_VEL_P": 5.0, "PSC_JERK_D": 5.0, "PSC_JERK_NE": 5.0, "PSC_NE_POS_P": 1.0,
    "PSC_NE_VEL_D": 0.25, "PSC_NE_VEL_I": 1.0, "PSC_NE_VEL_P": 2.0,
    "RC_FS_TIMEOUT": 1.0, "RNGFND1_MAX": 7.0, "RNGFND1_MIN": 0.2, "RNGFND1_ORIENT": 25, "RNGFND1_POS_X": 0.0,
    "RNGFND1_POS_Y": 0.0, "RNGFND1_POS_Z": 0.0, "RNGFND1_TYPE": 0,
    "RTL_ALT_M": 15.0, "RTL_CLIMB_MIN_M": 0.0, "RTL_CONE_SLOPE": 3.0,
    "SCR_ENABLE": 0, "UVR_COMP_ID": 191, "UVR_SILENCE_S": 1.5,
    "VISO_DELAY_MS": 10, "VISO_ORIENT": 0, "VISO_POS_M_NSE": 0.2, "VISO_POS_X": 0.0, "VISO_POS_Y": 0.0, "VISO_POS_Z": 0.0,
    "VISO_QUAL_MIN": 0, "VISO_SCALE": 1.0, "VISO_TYPE": 0, "VISO_VEL_M_NSE": 0.1, "VISO_YAW_M_NSE": 0.2,
    "WP_ACC": 2.5, "WP_ACC_Z": 1.0, "WP_SPD": 10.0, "WP_SPD_DN": 1.5, "WP_SPD_UP": 2.5, "WP_YAW_BEHAVIOR": 2,
}  # fmt: skip

DEFAULT_FILE = Path(__file__).resolve().parents[3] / "firmware_params" / "ardupilot_indoor.param"
FLOW_FILE = DEFAULT_FILE.with_name("ardupilot_flow.param")  # in addition, with a flow module


class ArduPilotParameters(ParameterTable):
    """Parameter table of ArduPilot: all values are sent as floats.

    INT32 stands for its three integer types.
    """

    def __init__(self) -> None:
        super().__init__(_DEFAULTS)

    @staticmethod
    def load(path: Path = DEFAULT_FILE) -> ArduPilotParameters:
        """Return the defaults with the values of a file.

        Raises ParameterError for an unknown name, an invalid line or an invalid value.
        """
        parameters = ArduPilotParameters()
        parameters._read(path, parameters._take_line)
        return parameters

    def _take_line(self, line: str) -> None:
        name, comma, value = line.partition(",")
        if not comma:
            raise ValueError("expected a name and a value with a comma between them")
        if name not in self:
            raise ValueError(f"unknown parameter {name}")
        self.set(name, int(value) if self.kind(name) == INT32 else float(value))
