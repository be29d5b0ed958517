"""Firmware process: it is started, followed and ended, and faults are reported in one line.

A stub program replaces the binary.
"""

from __future__ import annotations

import math
import socket
import struct
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.mavlink_codec import MessageDecoder, MessageEncoder, ReceivedMessage, packet
from sitl.real_firmware.ardupilot import ArduPilotBinary
from sitl.real_firmware.firmware_vehicle import FirmwareVehicle, _version
from sitl.real_firmware.process import FirmwareError
from sitl.real_firmware.px4 import COMPANION_PORT, Px4Binary
from sitl.real_firmware.true_trajectory import TrueTrajectory

HALF = math.sqrt(0.5)
EAST = (HALF, 0.0, 0.0, HALF)  # ned_from_frd of a level body heading east
STAND_IN = """#!{python}
import socket, sys, time
from pymavlink.dialects.v20 import common as mavlink
from sitl.autopilots.mavlink_codec import MessageDecoder, MessageEncoder, packet

port = int(next(a for a in sys.argv if a.startswith("--serial1=")).rpartition(":")[2])
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
    link.connect(("127.0.0.1", port))
    link.settimeout(0.01)
    vehicle, other, heard, asked = MessageEncoder(1, 1), MessageEncoder(7, 1), MessageDecoder(), set()
    print("hello", flush=True)
    {first}
    for tick in range(6000):
        fly = tick >= 20
        link.send(other.frame(packet(mavlink.MAVLink_sim_state_message, *[9.0] * 21, 5, 5)))
        link.send(vehicle.frame(packet(mavlink.MAVLink_heartbeat_message, 2, 3, 128 * fly, 9 * fly, 4, 3)))
        state = [{q}, 0, 0, 0, 0, 0, -9.8, 0, 0, 0, 0, 0, 7.0 + fly, 0, 0, 0, 0, 0, 470000000 + 100 * fly, 80000000]
        link.send(vehicle.frame(packet(mavlink.MAVLink_sim_state_message, *state)))
        try:
            for message in heard.feed(link.recv(2048)):
                if tick < 5:
                    continue  # it boots
                asked.add((message.command, message.param1, message.param2))
                ack = packet(mavlink.MAVLink_command_ack_message, message.command, 0, 0, 0, 251, 1)
                link.send(vehicle.frame(ack))
                wanted = {{(511, 108.0, 10000.0), (511, 0.0, 20000.0), (511, 2.0, 200000.0), (511, 1.0, 1e6)}}
                if message.command == 512 and asked >= wanted:
                    commit = list(b"8f898471")
                    fields = [0, (4 << 24) | (8 << 16), 0, 0, 0, commit, [0] * 8, [0] * 8, 0, 0, 0, [0] * 18]
                    for kind, said in (
                        (mavlink.MAVLink_system_time_message, (0, 1500)),
                        (mavlink.MAVLink_sys_status_message, (*[0] * 6, 77, *[0] * 9)),
                        (mavlink.MAVLink_statustext_message, (4, b"EKF Failsafe: changed to LAND Mode")),
                        (mavlink.MAVLink_autopilot_version_message, fields),
                    ):
                        link.send(vehicle.frame(packet(kind, *said)))
        except OSError:
            continue
"""


def stand_in(folder: Path, first: str = "pass") -> Path:
    path = folder / "arducopter"
    path.write_text(STAND_IN.format(python=sys.executable, first=first, q=", ".join(map(repr, EAST))), encoding="ascii")
    path.chmod(0o755)
    return path


def started(tmp_path: Path, first: str = "pass") -> FirmwareVehicle:
    binary = ArduPilotBinary(stand_in(tmp_path, first))
    return FirmwareVehicle(binary, 24571, 0.5, tmp_path / "scratch", tmp_path / "firmware.log")


@pytest.fixture
def vehicle(tmp_path: Path) -> Iterator[FirmwareVehicle]:
    with closing(started(tmp_path)) as flying:
        yield flying


def test_the_world_follows_the_state_that_the_firmware_reports(vehicle: FirmwareVehicle) -> None:
    truth = vehicle.truth()
    assert truth.position == (0.0, 0.0, 0.0)
    assert truth.quat_wxyz == pytest.approx((math.cos(0.25), 0.0, 0.0, math.sin(0.25)))
    assert truth.specific_force == pytest.approx((0.0, 0.0, 9.8))
    end_s = time.monotonic() + 20.0
    while not (vehicle.version and vehicle.truth().position[2] > 0.5) and time.monotonic() < end_s:
        vehicle.step(time.monotonic())
    truth, north_m = vehicle.truth(), 100 * 0.011131884502145034
    turn = 0.5  # the heading was east, which is the scene's start heading, so north is to the left
    assert truth.position == pytest.approx((-math.sin(turn) * north_m, math.cos(turn) * north_m, 1.0), abs=0.03)
    assert (truth.armed, truth.mode, vehicle.version) == (True, "LAND", "4.8.0 (8f898471)")
    assert vehicle.failsafes == vehicle.texts == ["EKF Failsafe: changed to LAND Mode"]
    assert vehicle.battery_fraction == pytest.approx(0.77)
    assert -20.0 < vehicle.boot_s - time.monotonic() + 1.5 <= 0.0
    assert vehicle.setpoint_arrivals_s == []


def test_the_pilot_sets_the_mode_switch_and_holds_the_sticks(tmp_path: Path) -> None:
    binary = ArduPilotBinary(stand_in(tmp_path))
    with (
        closing(FirmwareVehicle(binary, 24571, 0.5, tmp_path / "scratch", tmp_path / "firmware.log")) as vehicle,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
    ):
        receiver.bind(("127.0.0.1", binary.transmitter.port))
        receiver.settimeout(5.0)
        with pytest.raises(KeyError):
            vehicle.pilot_takes_over("POSCTL")
        vehicle.pilot_takes_over("ALT_HOLD")
        vehicle.step(time.monotonic())
        assert struct.unpack("<8H", receiver.recv(64))[4] == 1425


def test_the_error_for_an_ended_firmware_has_its_last_output(tmp_path: Path) -> None:
    with pytest.raises(FirmwareError, match=r"^arducopter ended with exit code 3; its last output: no such model$") as failure:
        started(tmp_path, "print('no such model', flush=True); sys.exit(3)")
    assert "\n" not in str(failure.value)


def test_a_firmware_that_dies_in_flight_is_detected(tmp_path: Path) -> None:
    with closing(
        started(tmp_path, "import os, threading; threading.Timer(1.0, lambda: os.kill(os.getpid(), 11)).start()")
    ) as v:
        end_s = time.monotonic() + 20.0
        with pytest.raises(FirmwareError, match="arducopter was killed by SIGSEGV; its last output: hello"):
            while time.monotonic() < end_s:
                v.step(time.monotonic())


def test_a_file_that_is_not_executable_code_is_named(tmp_path: Path) -> None:
    path = tmp_path / "arducopter"
    path.write_bytes(b"\x7fELF not really")
    path.chmod(0o755)
    with pytest.raises(FirmwareError, match="Exec format error"):
        FirmwareVehicle(ArduPilotBinary(path), 24571, 0.0, tmp_path / "scratch", tmp_path / "firmware.log")


def test_arducopter_gets_its_ports_and_its_parameters(tmp_path: Path) -> None:
    copter = ArduPilotBinary(Path("/x/arducopter"))
    command = copter.command(tmp_path, 24571, 40000)
    assert command[0] == "/x/arducopter"
    assert "--serial0=udpclient:127.0.0.1:24571" in command
    assert "--serial1=udpclient:127.0.0.1:40000" in command
    assert [word for word in command if word.endswith("=none")] == [f"--serial{n}=none" for n in range(2, 9)]
    lines = Path(command[command.index("--defaults") + 1]).read_text(encoding="ascii").splitlines()
    assert len({line.partition(",")[0] for line in lines}) == len(lines)
    assert command[command.index("--rc-in-port") + 1] == str(copter.transmitter.port)
    assert {"FLTMODE1,5", "FLTMODE4,0", "FLTMODE_CH,5"} <= set(lines)
    assert [copter.mode(m) for m in (4, 9, 99)] == ["GUIDED", "LAND", "99"]
    assert {"FRAME_CLASS,1", "VISO_TYPE,1", "MAV_GCS_SYSID,233", "FS_EKF_THRESH,0.6", "MNT1_TYPE,0"} <= set(lines)


def test_px4_gets_its_model_and_its_parameters(tmp_path: Path) -> None:
    px4 = Px4Binary(Path("/b/bin/px4"))
    assert px4.command(tmp_path, COMPANION_PORT, px4.truth_port) == [
        "/b/bin/px4",
        "-i",
        "0",
        "-d",
        "/b/etc",
        "-w",
        str(tmp_path),
    ]
    with pytest.raises(ValueError, match="14540 and 19410, not to 24571"):
        px4.command(tmp_path, 24571, px4.truth_port)
    environment = px4.environment()
    assert environment["PX4_SIM_MODEL"] == "sihsim_quadx"
    assert environment["PX4_PARAM_COM_OBL_RC_ACT"] == "4"


def test_px4s_true_state_is_converted_from_its_units() -> None:
    px4, path, speaker, listener = (
        Px4Binary(Path("/b/bin/px4")),
        TrueTrajectory(Px4Binary.grain, math.pi / 2.0),
        MessageEncoder(1, 1),
        MessageDecoder(),
    )

    def say(stamp_s: float, kind: object, *fields: object) -> None:
        for message in listener.feed(speaker.frame(packet(kind, *fields))):
            px4.follow(message, stamp_s, path)

    state = mavlink.MAVLink_hil_state_quaternion_message
    say(1.0, state, 0, [1, 0, 0, 0], 0, 0, 0, 473977420, 85455940, 488000, 0, 0, 0, 0, 0, 0, 0, 0)
    say(3.0, state, 0, [1, 0, 0, 0], 0, 0.25, 0, 473977420 + 90, 85455940, 489500, 50, 0, -25, 0, 0, 0, 0, 0)
    motion = path.at(3.0)
    assert motion.position == pytest.approx((0.0, 1.0, 1.5), abs=0.02)
    assert motion.velocity == pytest.approx((0.0, 0.5, 0.25))
    assert motion.specific_force == pytest.approx((0.0, 0.0, 9.80665))
    say(3.04, state, 0, [1, 0, 0, 0], 0, 0.25, 0, 473977420 + 92, 85455940, 489510, 52, 0, -25, 0, 0, 0, 0, 0)
    motion = path.at(3.04)
    assert motion.specific_force == pytest.approx((0.5, 0.0, 9.80665)), "it begins to go north, where its nose points"
    assert motion.gyro == pytest.approx((0.0, -0.25, 0.0))
    assert [px4.mode(m) for m in (4 << 16 | 6 << 24, 6 << 16, 99)] == ["LAND", "OFFBOARD", "99"]


@pytest.mark.parametrize(
    ("told", "says"),
    [
        (b"8f898471", "1.17.0 (8f898471)"),
        (bytes.fromhex("00000059d7ee735b"), "1.17.0 (5b73eed759)"),
        (b"", "1.17.0"),
    ],
    ids=["letters, as ArduPilot", "five bytes, as PX4", "a build that knows none"],
)
def test_a_version_includes_the_commit_if_known(told: bytes, says: str) -> None:
    message = ReceivedMessage(flight_sw_version=1 << 24 | 17 << 16, flight_custom_version=list(told.ljust(8, b"\0")))
    assert _version(message) == says
