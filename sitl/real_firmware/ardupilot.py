"""ArduCopter's own simulation: how its binary is started, and how it says where its vehicle really is."""

from __future__ import annotations

import shutil
from pathlib import Path

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.ardupilot.modes import ArduPilotMode
from sitl.autopilots.ardupilot.parameters import DEFAULT_FILE
from sitl.autopilots.mavlink_codec import ReceivedMessage
from sitl.real_firmware.rc_transmitter import RcTransmitter
from sitl.real_firmware.true_trajectory import Grain, Inertial, Reading, TrueTrajectory

_HOME = "47.397742,8.545594,0,0"  # latitude, longitude, height, heading: any place will do
_SERIAL_PORTS = 9
# What a bench would have set up on the airframe of its `quad` model, before anybody flies: frame, calibration, battery, sticks.
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
# What the transmitter's switch means, and the pulses that are in the middle of its places; it lies at 1800 to begin with.
_SWITCH = {ArduPilotMode.LOITER: 1165, ArduPilotMode.POSHOLD: 1295, ArduPilotMode.ALT_HOLD: 1425, ArduPilotMode.STABILIZE: 1555}
# No gimbal answers in its simulation, and a mount that is configured but silent keeps it from arming.
_BENCH: dict[str, float] = {
    "MNT1_TYPE": 0,
    "FLTMODE_CH": 5, "FLTMODE5": ArduPilotMode.STABILIZE, "FLTMODE6": ArduPilotMode.STABILIZE,
    **{f"FLTMODE{place}": mode for place, mode in enumerate(_SWITCH, 1)},
}  # fmt: skip


class ArduPilotBinary:
    """`--autopilot ardupilot --firmware PATH`: ArduCopter for SITL, 4.5.2 or newer, its `quad` model in real time.

    It sends to the companion as a UDP client on SERIAL0, and the truth (SIM_STATE) to whoever listens on SERIAL1. Every other
    port is off but that of its sticks, which it opens on all networks whatever it is told: at least its number is another one
    each time.
    """

    grain = Grain(metres_per_e7=0.011131884502145034, height_step_m=0.01)
    streams_hz = ((mavlink.MAVLINK_MSG_ID_SIM_STATE, 100.0),)
    asked_again = ()
    set_late = ()  # it reads them all from a file
    truth_port = companion_port = 0  # any

    def __init__(self, binary: Path, parameters: Path = DEFAULT_FILE) -> None:
        self._binary, self._parameters = binary, parameters
        self.transmitter = RcTransmitter({mode.name: pulse_us for mode, pulse_us in _SWITCH.items()})

    def command(self, folder: Path, companion_port: int, truth_port: int) -> list[str]:
        """What starts it in a folder that is empty, with the card's scripts in it."""
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
        """One value for each name: of two, its parts disagree which they take."""
        flown = {}
        for line in self._parameters.read_text(encoding="ascii").splitlines():
            name, comma, value = line.partition(",")
            if comma and not line.startswith("#"):
                flown[name] = float(value)
        return {**_AIRFRAME, **flown, **_BENCH}

    def environment(self) -> dict[str, str]:
        """Nothing of ours."""
        return {}

    def follow(self, message: ReceivedMessage, stamp_s: float, path: TrueTrajectory) -> None:
        """Take the truth out of a message, if there is any in it."""
        if message.kind != mavlink.MAVLINK_MSG_ID_SIM_STATE:
            return
        path.feel(Inertial((message.xgyro, message.ygyro, message.zgyro), (message.xacc, message.yacc, message.zacc)))
        attitude = (message.q1, message.q2, message.q3, message.q4)
        velocity = (message.vn, message.ve, message.vd)
        path.take(stamp_s, Reading(message.lat_int, message.lon_int, message.alt, velocity, attitude))

    def mode(self, custom_mode: int) -> str:
        """A mode of the heartbeat by its name; a number without one is its own."""
        return _NAMES.get(custom_mode, str(custom_mode))
