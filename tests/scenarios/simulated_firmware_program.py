"""The simulated ArduCopter as a program that is started as ArduPilot's own simulation is, and speaks as it does.

It stands in for the real binary where the way from `sim --firmware` to a report is to be flown, not the firmware. Run it as
an executable: `firmware_stand_in.py --serial0=udpclient:127.0.0.1:PORT --serial1=udpclient:127.0.0.1:PORT`.
"""

from __future__ import annotations

import math
import sys
import time

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilots.ardupilot.autopilot import ArduCopter
from sitl.autopilots.ardupilot.modes import ArduPilotMode
from sitl.autopilots.ardupilot.parameters import ArduPilotParameters
from sitl.autopilots.base_autopilot import VehicleTruth
from sitl.autopilots.byte_links import UdpPeer
from sitl.autopilots.mavlink_codec import MessageDecoder, MessageEncoder, Packet, packet
from sitl.geometry.ned_frd import frd_from_flu, ned_frd_from_enu_flu, ned_from_enu
from sitl.world.quadrotor import Quadrotor

LATITUDE_E7, LONGITUDE_E7, METRES_PER_E7 = 473977420, 85455940, 0.011131884502145034
TURN_S, TRUTH_S, HEARTBEAT_S = 0.004, 0.01, 0.2


def main(words: list[str]) -> None:
    """Fly until somebody ends it."""
    ports = {word[2:9]: int(word.rpartition(":")[2]) for word in words if word.startswith(("--serial0=", "--serial1="))}
    companion, listener = (UdpPeer(remote=("127.0.0.1", ports[name])) for name in ("serial0", "serial1"))
    copter = ArduCopter(Quadrotor(seed=0), companion, ArduPilotParameters.load(), seed=0)
    speaker, ears = MessageEncoder(1, 1), MessageDecoder()
    next_truth_s = next_heartbeat_s = 0.0
    while True:
        now_s = time.monotonic()
        copter.step(now_s)
        truth = copter.truth()
        if now_s >= next_truth_s:
            next_truth_s = now_s + TRUTH_S
            listener.write(speaker.frame(sim_state(truth)))
        if now_s >= next_heartbeat_s:
            next_heartbeat_s = now_s + HEARTBEAT_S
            listener.write(speaker.frame(heartbeat(truth)))
        for message in ears.feed(listener.read()):
            listener.write(speaker.frame(packet(mavlink.MAVLink_command_ack_message, message.command, 0)))
        time.sleep(TURN_S)


def heartbeat(truth: VehicleTruth) -> Packet:
    """Armed or not, and the mode."""
    return packet(mavlink.MAVLink_heartbeat_message, 2, 3, 128 * truth.armed, ArduPilotMode[truth.mode].value, 4, 3)


def sim_state(truth: VehicleTruth) -> Packet:
    """The truth as coarse as ArduPilot says it."""
    east, north, up = truth.position
    scale = math.cos(math.radians(LATITUDE_E7 * 1e-7))
    latitude_e7 = LATITUDE_E7 + int(north / METRES_PER_E7)
    longitude_e7 = LONGITUDE_E7 + int(east / METRES_PER_E7 / scale)
    return packet(
        mavlink.MAVLink_sim_state_message, *ned_frd_from_enu_flu(truth.quat_wxyz), 0.0, 0.0, 0.0,
        *frd_from_flu(truth.specific_force), *frd_from_flu(truth.gyro), 0.0, 0.0, int(up * 100) / 100, 0.0, 0.0,
        *ned_from_enu(truth.velocity), latitude_e7, longitude_e7,
    )  # fmt: skip


if __name__ == "__main__":
    main(sys.argv[1:])
