"""The flow module beside a real firmware sends what that firmware's MAVLink drivers take."""

from __future__ import annotations

import math
import sys
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.base_autopilot import VehicleTruth
from sitl.autopilots.mavlink_codec import MessageDecoder, MessageEncoder, Packet, ReceivedMessage
from sitl.geometry.quaternion import IDENTITY
from sitl.real_firmware.ardupilot import ArduPilotBinary
from sitl.real_firmware.firmware_vehicle import FirmwareVehicle
from sitl.real_firmware.flow_feed import FlowFeed, distance_below
from sitl.real_firmware.px4 import Px4Binary
from sitl.scene.scene import Scene
from sitl.world.flow_sensor import (
    FLOW_MOUNT_M,
    RANGE_FOV_RAD,
    RANGE_M,
    FlowMeasurement,
    FlowSensorErrors,
    RangeMeasurement,
    SimulatedFlowModule,
)
from uav_recon.autopilot.parameters.parameter_file import required

STEP_S = 0.004
RATE_HZ = 20.0
FLOOR_Z, HEIGHT_M = -0.1, 1.2  # HEIGHT_M: of the flow sensor above the floor
BODY_Z = FLOOR_Z + HEIGHT_M - FLOW_MOUNT_M[2]
READING = FlowMeasurement(7.0, 0.05, (0.02, -0.01), (0.001, 0.002, 0.003), 130)
DOWN = 25  # MAV_SENSOR_ROTATION_PITCH_270
PX4, ARDUPILOT = Px4Binary(Path("/b/bin/px4")), ArduPilotBinary(Path("/x/arducopter"))
MIRROR = """#!{python}
import socket, sys
from pymavlink.dialects.v20 import common as mavlink
from sitl.autopilots.mavlink_codec import MessageEncoder, packet

port = int(next(a for a in sys.argv if a.startswith("--serial1=")).rpartition(":")[2])
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link, open("heard", "ab", buffering=0) as heard:
    link.connect(("127.0.0.1", port))
    link.settimeout(0.01)
    vehicle = MessageEncoder(1, 1)
    while True:
        state = [1, 0, 0, 0, 0, 0, 0, 0, 0, -9.8, 0, 0, 0, 0, 0, 488.0, 0, 0, 0, 0, 0, 470000000, 80000000]
        link.send(vehicle.frame(packet(mavlink.MAVLink_sim_state_message, *state)))
        try:
            heard.write(link.recv(2048))
        except OSError:
            continue
"""


def module() -> SimulatedFlowModule:
    """Return an exact module over a level floor."""
    corners = [(-20.0, -20.0, FLOOR_Z), (20.0, -20.0, FLOOR_Z), (20.0, 20.0, FLOOR_Z), (-20.0, 20.0, FLOOR_Z)]
    faces, grey = np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.full((4, 3), 128, np.uint8)
    floor = Scene("floor", np.array(corners, np.float32), faces, grey, 0.0, np.full(3, -9.0), np.full(3, 9.0), np.zeros(3))
    return SimulatedFlowModule(floor, 1, FlowSensorErrors(rate_hz=RATE_HZ))


def forward(stamp_s: float, speed_mps: float = 1.0) -> VehicleTruth:
    """Return the truth of a level flight forward."""
    position = (speed_mps * stamp_s, 0.0, BODY_Z)
    return VehicleTruth(stamp_s, position, (speed_mps, 0.0, 0.0), IDENTITY, (0.0,) * 3, (0.0, 0.0, 9.8), 0.0, True, "GUIDED")


def received(packets: list[Packet]) -> list[ReceivedMessage]:
    speaker = MessageEncoder(251, 1)
    return MessageDecoder().feed(b"".join(speaker.frame(p) for p in packets))


def flown(binary: Px4Binary | ArduPilotBinary, seconds: float) -> list[ReceivedMessage]:
    feed = FlowFeed(module(), binary.optical_flow)
    return received([p for tick in range(round(seconds / STEP_S)) for p in feed.step(forward(tick * STEP_S))])


def test_px4_gets_angles_over_the_interval_and_the_sensors_own_turn() -> None:
    (message,) = received([PX4.optical_flow(READING)])
    assert message.kind == mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW_RAD
    assert (message.integration_time_us, message.quality) == (50_000, 130)
    assert (message.integrated_x, message.integrated_y) == pytest.approx((0.02, -0.01))
    assert (message.integrated_xgyro, message.integrated_ygyro, message.integrated_zgyro) == pytest.approx(
        (0.001, 0.002, 0.003)
    )
    assert message.distance < 0.0, "PX4 then uses the range finder"


def test_arducopter_gets_rates_in_the_fields_of_radians_per_second() -> None:
    (message,) = received([ARDUPILOT.optical_flow(READING)])
    assert message.kind == mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW
    assert (message.flow_rate_x, message.flow_rate_y) == pytest.approx((0.4, -0.2))
    assert (message.flow_x, message.flow_y, message.quality) == (0, 0, 130)


@pytest.mark.parametrize(
    ("range_m", "valid", "cm", "signal"),
    [(1.234, True, 123, 0), (RANGE_M[0], True, 5, 0), (RANGE_M[1], False, 401, 1), (RANGE_M[0], False, 4, 1)],
    ids=["in range", "at the lower limit", "beyond", "too near"],
)
def test_a_distance_that_is_not_valid_lies_outside_its_limits(range_m: float, valid: bool, cm: int, signal: int) -> None:
    (message,) = received([distance_below(RangeMeasurement(7.0, range_m, valid))])
    assert (message.kind, message.orientation) == (mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR, DOWN)
    assert (message.min_distance, message.max_distance) == (5, 400)
    assert (message.current_distance, message.signal_quality) == (cm, signal)
    assert message.horizontal_fov == message.vertical_fov == pytest.approx(RANGE_FOV_RAD)


@pytest.mark.parametrize("binary", [PX4, ARDUPILOT], ids=["px4", "ardupilot"])
def test_each_reading_is_sent_once_at_the_sensors_rates(binary: Px4Binary | ArduPilotBinary) -> None:
    messages = flown(binary, 2.0)
    ranges = [m for m in messages if m.kind == mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR]
    flows = [m for m in messages if m.kind != mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR]
    assert len(ranges) == pytest.approx(40, abs=1)
    assert len(flows) == pytest.approx(40, abs=2)
    assert {m.current_distance for m in ranges} <= set(range(113, 128)), "of 1.2 m"


def test_a_flight_forward_is_positive_flow_about_y() -> None:
    rates = [m.flow_rate_y for m in flown(ARDUPILOT, 1.0) if m.kind == mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW and m.quality]
    assert np.mean(rates) == pytest.approx(1.0 / HEIGHT_M, rel=0.02)
    angles = [m.integrated_y for m in flown(PX4, 1.0) if m.kind == mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW_RAD and m.quality]
    assert np.mean(angles) == pytest.approx(1.0 / HEIGHT_M / RATE_HZ, rel=0.1)


def test_a_vehicle_with_the_module_sends_its_readings_to_the_firmware(tmp_path: Path) -> None:
    program, folder = tmp_path / "arducopter", tmp_path / "scratch"
    program.write_text(MIRROR.format(python=sys.executable), encoding="ascii")
    program.chmod(0o755)
    with closing(FirmwareVehicle(ArduPilotBinary(program, flow=True), 24571, 0.0, folder, tmp_path / "log")) as vehicle:
        vehicle.mount_flow_module(module())
        wanted = {mavlink.MAVLINK_MSG_ID_OPTICAL_FLOW, mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR}
        heard: set[int] = set()
        end_s = time.monotonic() + 20.0
        while not wanted <= heard and time.monotonic() < end_s:
            vehicle.step(time.monotonic())
            heard = {m.kind for m in MessageDecoder().feed((folder / "heard").read_bytes())}
    assert wanted <= heard


def loaded(autopilot: str, flow: bool, folder: Path) -> dict[str, float]:
    """Return the parameters that the binary is started with."""
    if autopilot == "px4":
        words = Px4Binary(Path("/b/bin/px4"), flow=flow).environment().items()
        return {name.removeprefix("PX4_PARAM_"): float(value) for name, value in words if name.startswith("PX4_PARAM_")}
    command = ArduPilotBinary(Path("/x/arducopter"), flow=flow).command(folder, 24571, 40000)
    lines = Path(command[command.index("--defaults") + 1]).read_text(encoding="ascii").splitlines()
    assert len({line.partition(",")[0] for line in lines}) == len(lines), "each name once"
    return {name: float(value) for name, _, value in (line.partition(",") for line in lines)}


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_the_firmware_flies_what_params_flow_demands(autopilot: str, tmp_path: Path) -> None:
    values = loaded(autopilot, True, tmp_path)
    demanded = {p.name: p.value for p in required(autopilot, flow=True)}
    demanded.pop("MNT1_TYPE", None)  # its simulation has no gimbal
    assert {name: values[name] for name in demanded} == pytest.approx(demanded)


def test_px4s_own_range_finder_is_off_only_beside_the_module(tmp_path: Path) -> None:
    assert abs(loaded("px4", True, tmp_path)["SIH_DISTSNSR_OVR"]) > 10000.0
    assert "SIH_DISTSNSR_OVR" not in loaded("px4", False, tmp_path)
    assert loaded("px4", False, tmp_path)["EKF2_OF_CTRL"] == 0.0


def test_arducopter_reads_the_module_by_mavlink(tmp_path: Path) -> None:
    values = loaded("ardupilot", True, tmp_path)
    assert (values["FLOW_TYPE"], values["RNGFND1_TYPE"], values["RNGFND1_ORIENT"]) == (5.0, 10.0, DOWN)
    assert (values["RNGFND1_MIN"], values["RNGFND1_MAX"]) == RANGE_M
    assert (values["FLOW_POS_Z"], values["FLOW_POS_Y"]) == (-FLOW_MOUNT_M[2], -FLOW_MOUNT_M[1])
    assert "FLOW_TYPE" not in loaded("ardupilot", False, tmp_path)


def test_the_values_of_the_flow_file_are_set_again_after_px4s_start() -> None:
    after = {name: (wire, kind) for name, wire, kind in Px4Binary(Path("/b/bin/px4"), flow=True).parameters_after_start}
    assert after["SENS_FLOW_RATE"] == (20.0, mavlink.MAV_PARAM_TYPE_REAL32)
    wire, kind = after["EKF2_OF_CTRL"]
    assert (kind, math.ldexp(wire, 149)) == (mavlink.MAV_PARAM_TYPE_INT32, 1.0), "the bytes of the integer 1"
