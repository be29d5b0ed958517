"""PX4's simulation in hardware (SIH): start of its binary and decoding of its ground truth."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.flow_parameters import flow_parameters
from sitl.autopilots.mavlink_codec import Packet, ReceivedMessage, packet
from sitl.autopilots.px4.commander import Px4Mode
from sitl.autopilots.px4.parameters import DEFAULT_FILE, FLOW_FILE, INT32
from sitl.real_firmware.true_trajectory import Inertial, PositionResolution, Reading, TrueTrajectory
from sitl.world.flow_sensor import FlowMeasurement

COMPANION_PORT = 14540  # destination port of its first instance, system 1
_TRUTH_PORT = 19410  # destination port of SIH's display output, from its start script
_MODEL = "sihsim_quadx"
# Settings that depend on the airframe. Drag, N s/m on 1 kg: chosen, not measured; below half of the default 1.0.
# Noise: that of its simulated sensor over 10 ms, three to six times the estimator's default.
# Battery: by default half empty after 30 s, which makes a mission return; set to 21 minutes, as for the simulated autopilot.
_BENCH = {"SIH_KDV": "0.4", "EKF2_ACC_NOISE": "1.0", "EKF2_GYR_NOISE": "0.09", "SIM_BAT_DRAIN": "1260"}
# its own range finder, which measures above the plane of the pad, off: an absolute value above 10000 disables it
_FLOW_BENCH = {"SIH_DISTSNSR_OVR": "20000"}
_NAMES = {mode.value: mode.name for mode in Px4Mode}


class _Parameter(NamedTuple):
    """One line of a parameter file: value as text and MAV_PARAM_TYPE."""

    value: str
    kind: int

    def on_wire(self) -> float:
        """Return the float of a PARAM_SET: PX4 takes the BYTES of an INT32 from it."""
        number: float = struct.unpack("<f", struct.pack("<i", int(self.value)))[0] if self.kind == INT32 else float(self.value)
        return number


class Px4Binary:
    """PX4 with SIH (`--autopilot px4 --firmware PATH`), 1.15.4 or newer.

    PATH is BUILD/bin/px4 of a build of px4_sitl_nolockstep with SIH; BUILD/etc is used, too. A lockstep build is not
    suitable: its clock falls behind by 1 % on an idle machine and by 13 % on a busy one (measured).
    Its start script sends to the companion on port 14540 and the truth (HIL_STATE_QUATERNION) to port 19410; both are fixed.
    The accelerations in the truth are rounded to whole m/s^2, and its simulated IMU has a noise of 1.7 m/s^2 and 0.14 rad/s,
    which a camera's IMU would not have. Therefore the camera's IMU is derived from the true velocities and rates.
    """

    grain = PositionResolution(metres_per_e7=0.011119492664455873, height_step_m=0.001)
    streams_hz = ((mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION, 100.0),)
    truth_port, companion_port = _TRUTH_PORT, COMPANION_PORT
    polled_messages = (mavlink.MAVLINK_MSG_ID_HEARTBEAT,)  # its rate cannot be set
    transmitter = None  # its simulation has no sticks

    def __init__(self, binary: Path, parameters: Path = DEFAULT_FILE, *, flow: bool = False) -> None:
        """flow: a flow module is mounted; its parameters are set, too."""
        self._binary = binary
        self._files = (parameters, FLOW_FILE) if flow else (parameters,)
        self._flow = flow

    def command(self, folder: Path, companion_port: int, truth_port: int) -> list[str]:
        """Return the command line that starts it in an empty folder.

        Raises ValueError for ports other than the fixed ones.
        """
        if (companion_port, truth_port) != (COMPANION_PORT, _TRUTH_PORT):
            raise ValueError(f"PX4 sends to {COMPANION_PORT} and {_TRUTH_PORT}, not to {companion_port} and {truth_port}")
        return [str(self._binary), "-i", "0", "-d", str(self._binary.parent.parent / "etc"), "-w", str(folder)]

    def environment(self) -> dict[str, str]:
        """Return the model and the parameters; the start script reads those from PX4_PARAM_NAME."""
        values = _BENCH | (self._module() if self._flow else {}) | {name: p.value for name, p in self._wanted().items()}
        chosen = {f"PX4_PARAM_{name}": value for name, value in values.items()}
        return {"PX4_SIM_MODEL": _MODEL, "PX4_SIMULATOR": "sihsim", **chosen}

    @property
    def parameters_after_start(self) -> Iterable[tuple[str, float, int]]:
        """All of the files again, because its start script changes some defaults (SYS_FAILURE_EN)."""
        return [(name, p.on_wire(), p.kind) for name, p in self._wanted().items()]

    def _wanted(self) -> dict[str, _Parameter]:
        lines = [line for path in self._files for line in path.read_text(encoding="utf-8").splitlines()]
        fields = (line.split("\t") for line in lines if line and line[0] != "#")
        return {name: _Parameter(value, int(kind)) for _, _, name, value, kind in fields}

    @staticmethod
    def _module() -> dict[str, str]:
        return {name: f"{value:g}" for name, value in flow_parameters("px4").items()} | _FLOW_BENCH

    def follow(self, message: ReceivedMessage, stamp_s: float, path: TrueTrajectory) -> None:
        """Add the ground truth of a message to the path; other messages are ignored."""
        if message.kind == mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION:
            path.set_inertial(Inertial((message.rollspeed, message.pitchspeed, message.yawspeed), None))
            w, x, y, z = message.attitude_quaternion
            velocity = (message.vx * 0.01, message.vy * 0.01, message.vz * 0.01)
            path.take(stamp_s, Reading(message.lat, message.lon, message.alt * 1e-3, velocity, (w, x, y, z)))

    def mode(self, custom_mode: int) -> str:
        """Return the name of a heartbeat's custom_mode, or the number if it has no name."""
        return _NAMES.get(custom_mode, str(custom_mode))

    def optical_flow(self, measured: FlowMeasurement) -> Packet:
        """Return OPTICAL_FLOW_RAD.

        From the sources (mavlink_receiver.cpp): the time is that of arrival; a negative distance is none, and that of the range
        finder is used.
        """
        interval_us = round(measured.interval_s * 1e6)
        return packet(
            mavlink.MAVLink_optical_flow_rad_message,
            0, 0, interval_us, *measured.flow_rad, *measured.gyro_rad, 0, measured.quality, 0, -1.0,
        )  # fmt: skip
