"""PX4's simulation in hardware, SIH: how its binary is started, and how it says where its vehicle really is."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.mavlink_codec import ReceivedMessage
from sitl.autopilots.px4.commander import Px4Mode
from sitl.autopilots.px4.parameters import DEFAULT_FILE, Px4Parameters
from sitl.real_firmware.true_trajectory import Grain, Inertial, Reading, TrueTrajectory

COMPANION_PORT = 14540  # where its first instance sends, as system 1
_TRUTH_PORT = 19410  # where its start script sends SIH's display
_MODEL = "sihsim_quadx"
# What a bench would set up for its airframe. Drag, N s/m on 1 kg: chosen, not measured, less than half of its own 1.0.
# Noise: as its simulated sensor has it over 10 ms, three to six times what the estimator expects of one.
# Its battery would be half empty after 30 s and stay so, from which a mission turns back: 21 minutes, as the simulated one's.
_BENCH = {"SIH_KDV": "0.4", "EKF2_ACC_NOISE": "1.0", "EKF2_GYR_NOISE": "0.09", "SIM_BAT_DRAIN": "1260"}
_NAMES = {mode.value: mode.name for mode in Px4Mode}


class Px4Binary:
    """`--autopilot px4 --firmware PATH`: PATH is BUILD/bin/px4 of a build of px4_sitl_nolockstep with SIH, 1.15.4 or newer;
    BUILD/etc is used with it. In lockstep its clock falls behind, by 1 % on an idle machine and 13 % on a busy one (measured).

    Its start script sends to the companion on 14540 and the truth (HIL_STATE_QUATERNION) to 19410; both are fixed there.
    The truth's accelerations are cut to whole m/s^2, and its own simulated sensor has a noise of 1.7 m/s^2 and 0.14 rad/s that
    no camera would feel: what is felt follows from the truth's velocities and turns.
    """

    grain = Grain(metres_per_e7=0.011119492664455873, height_step_m=0.001)
    streams_hz = ((mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION, 100.0),)
    truth_port, companion_port = _TRUTH_PORT, COMPANION_PORT
    asked_again = (mavlink.MAVLINK_MSG_ID_HEARTBEAT,)  # its rate cannot be set
    transmitter = None  # its simulation has no sticks

    def __init__(self, binary: Path, parameters: Path = DEFAULT_FILE) -> None:
        self._binary, self._parameters = binary, parameters

    def command(self, folder: Path, companion_port: int, truth_port: int) -> list[str]:
        """What starts it in a folder that is empty; the ports are its own. Raises ValueError for others."""
        if (companion_port, truth_port) != (COMPANION_PORT, _TRUTH_PORT):
            raise ValueError(f"PX4 sends to {COMPANION_PORT} and {_TRUTH_PORT}, not to {companion_port} and {truth_port}")
        return [str(self._binary), "-i", "0", "-d", str(self._binary.parent.parent / "etc"), "-w", str(folder)]

    def environment(self) -> dict[str, str]:
        """The model, and the parameters: its start script sets what is called PX4_PARAM_NAME."""
        chosen = {f"PX4_PARAM_{name}": value for name, value in (_BENCH | self._wanted()).items()}
        return {"PX4_SIM_MODEL": _MODEL, "PX4_SIMULATOR": "sihsim", **chosen}

    @property
    def set_late(self) -> Iterable[tuple[str, float, int]]:
        """All once more: its start script sets defaults of its own behind what is the firmware's default (SYS_FAILURE_EN)."""
        p = Px4Parameters.load(self._parameters)
        return [(name, p.on_wire(name), p.kind(name)) for name in self._wanted()]

    def _wanted(self) -> dict[str, str]:
        lines = self._parameters.read_text(encoding="utf-8").splitlines()
        return {name: value for _, _, name, value, _ in (line.split("\t") for line in lines if line and line[0] != "#")}

    def follow(self, message: ReceivedMessage, stamp_s: float, path: TrueTrajectory) -> None:
        """Take the truth out of a message, if there is any in it."""
        if message.kind == mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION:
            path.feel(Inertial((message.rollspeed, message.pitchspeed, message.yawspeed), None))
            w, x, y, z = message.attitude_quaternion
            velocity = (message.vx * 0.01, message.vy * 0.01, message.vz * 0.01)
            path.take(stamp_s, Reading(message.lat, message.lon, message.alt * 1e-3, velocity, (w, x, y, z)))

    def mode(self, custom_mode: int) -> str:
        """A mode of the heartbeat by its name; a number without one is its own."""
        return _NAMES.get(custom_mode, str(custom_mode))
