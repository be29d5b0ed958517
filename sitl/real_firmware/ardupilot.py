"""ArduCopter's own simulation: start of its binary and decoding of its ground truth."""

from __future__ import annotations

import shutil
from pathlib import Path

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.ardupilot.modes import ArduPilotMode
from sitl.autopilots.ardupilot.parameters import DEFAULT_FILE, FLOW_FILE
from sitl.autopilots.flow_parameters import flow_parameters
from sitl.autopilots.mavlink_codec import Packet, ReceivedMessage, packet
from sitl.real_firmware.rc_transmitter import RcTransmitter
from sitl.real_firmware.true_trajectory import Inertial, PositionResolution, Reading, TrueTrajectory
from sitl.world.flow_sensor import FlowMeasurement

_HOME = "47.397742,8.545594,0,0"  # latitude, longitude, height, heading; arbitrary
_SERIAL_PORTS = 9
# settings that depend on the airframe of the `quad` model: frame, calibration, battery, RC channels
_AIRFRAME: dict[str, float] = {
    "FRAME_CLASS": 1, "FRAME_TYPE": 0,
    **{f"INS_ACC{n}OFFS_{axis}": 0.001 for n in ("", "2") for axis in "XYZ"},
    **{f"INS_ACC{n}SCAL_{axis}": 1.001 for n in ("", "2") for axis in "XYZ"},
    "MOT_THST_EXPO": 0.65, "MOT_THST_HOVER": 0.39, "MOT_BAT_VOLT_MIN": 9.6, "MOT_BAT_VOLT_MAX": 12.8,
    "ATC_RAT_YAW_P": 0.3, "ATC_RAT_YAW_I": 0.02,
    "BATT_MONITOR": 4,
    **{f"RC{n}_{end}": pulse for n in range(1, 9) for end, pulse in (("MIN", 1000), ("TRIM", 1500), ("MAX", 2000))},
}  # fmt: skip
_NAMES = {mode.value: mode.name for mode in ArduPilotMode}
# mode switch of the transmitter: pulse (µs) at the centre of each position; the simulated receiver starts at 1800 µs
_SWITCH = {ArduPilotMode.LOITER: 1165, ArduPilotMode.POSHOLD: 1295, ArduPilotMode.ALT_HOLD: 1425, ArduPilotMode.STABILIZE: 1555}
# its simulation has no gimbal, and a configured mount that does not answer prevents arming
_BENCH: dict[str, float] = {
    "MNT1_TYPE": 0,
    "FLTMODE_CH": 5, "FLTMODE5": ArduPilotMode.STABILIZE, "FLTMODE6": ArduPilotMode.STABILIZE,
    **{f"FLTMODE{place}": mode for place, mode in enumerate(_SWITCH, 1)},
}  # fmt: skip
# its drivers of a flow sensor and a range finder that send MAVLink
_FLOW_DRIVERS: dict[str, float] = {"FLOW_TYPE": 5, "RNGFND1_TYPE": 10}


class ArduPilotBinary:
    """ArduCopter for SITL (`--autopilot ardupilot --firmware PATH`), 4.5.2 or newer.

    It simulates its `quad` model in real time. It sends to the companion as a UDP client on SERIAL0, and the truth
    (SIM_STATE) on SERIAL1. All other ports are disabled except the RC input, which it always opens on all network
    interfaces; therefore its port number is a different one each time.
    """

    grain = PositionResolution(metres_per_e7=0.011131884502145034, height_step_m=0.01)
    streams_hz = ((mavlink.MAVLINK_MSG_ID_SIM_STATE, 100.0),)
    polled_messages = ()
    parameters_after_start = ()  # all parameters are read from a file at the start
    truth_port = companion_port = 0  # any free port

    def __init__(self, binary: Path, parameters: Path = DEFAULT_FILE, *, flow: bool = False) -> None:
        """flow: a flow module is mounted; its parameters are set, too."""
        self._binary = binary
        self._parameters = parameters
        self._flow = flow
        self.transmitter = RcTransmitter({mode.name: pulse_us for mode, pulse_us in _SWITCH.items()})

    def command(self, folder: Path, companion_port: int, truth_port: int) -> list[str]:
        """Write parameters and Lua scripts into an empty folder; return the command line."""
        for script in self._parameters.parent.glob("*.lua"):
            (folder / "scripts").mkdir(exist_ok=True)
            shutil.copy(script, folder / "scripts")
        settings = folder / "settings.parm"
        settings.write_text("".join(f"{name},{value:.9g}\n" for name, value in self._settings().items()), encoding="ascii")
        serial = {0: f"udpclient:127.0.0.1:{companion_port}", 1: f"udpclient:127.0.0.1:{truth_port}"}
        ports = [f"--serial{n}={serial.get(n, 'none')}" for n in range(_SERIAL_PORTS)]
        return [
            str(self._binary), "--model", "quad", "--speedup", "1", "--home", _HOME, "--wipe",
            "--defaults", str(settings), "--rc-in-port", str(self.transmitter.port), *ports,
        ]  # fmt: skip

    def _settings(self) -> dict[str, float]:
        """Return one value per parameter.

        If a file has two values for a name, the parts of ArduPilot disagree on which one is valid.
        """
        if not self._flow:
            return {**_AIRFRAME, **_read(self._parameters), **_BENCH}
        module = {**flow_parameters("ardupilot"), **_read(FLOW_FILE), **_FLOW_DRIVERS}
        return {**_AIRFRAME, **_read(self._parameters), **module, **_BENCH}

    def environment(self) -> dict[str, str]:
        """Return additional environment variables: none."""
        return {}

    def follow(self, message: ReceivedMessage, stamp_s: float, path: TrueTrajectory) -> None:
        """Add the ground truth of a message to the path; other messages are ignored."""
        if message.kind != mavlink.MAVLINK_MSG_ID_SIM_STATE:
            return
        path.set_inertial(Inertial((message.xgyro, message.ygyro, message.zgyro), (message.xacc, message.yacc, message.zacc)))
        attitude = (message.q1, message.q2, message.q3, message.q4)
        velocity = (message.vn, message.ve, message.vd)
        path.take(stamp_s, Reading(message.lat_int, message.lon_int, message.alt, velocity, attitude))

    def mode(self, custom_mode: int) -> str:
        """Return the name of a heartbeat's custom_mode, or the number if it has no name."""
        return _NAMES.get(custom_mode, str(custom_mode))

    def optical_flow(self, measured: FlowMeasurement) -> Packet:
        """Return OPTICAL_FLOW.

        From the sources (AP_OpticalFlow_MAV.cpp): only flow_rate (rad/s) and quality are used. The turn is that of its own gyro
        since the reading before, and the time is that of arrival.
        """
        x, y = (angle / measured.interval_s for angle in measured.flow_rad)
        return packet(mavlink.MAVLink_optical_flow_message, 0, 0, 0, 0, 0.0, 0.0, measured.quality, -1.0, x, y)


def _read(path: Path) -> dict[str, float]:
    """Return the values of a parameter file."""
    fields = (line.partition(",") for line in path.read_text(encoding="ascii").splitlines() if not line.startswith("#"))
    return {name: float(value) for name, comma, value in fields if comma}
