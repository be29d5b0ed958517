"""MAVSDK, an independent client, arms, flies and lands both simulated autopilots.

Poses, time stamps and codec are MAVSDK's own. The test runs in real time, because MAVSDK supports no other clock. It is
skipped, and reported as skipped, if MAVSDK is not installed.
"""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from sitl.autopilots.ardupilot.autopilot import ArduCopter
from sitl.autopilots.ardupilot.parameters import ArduPilotParameters
from sitl.autopilots.base_autopilot import Autopilot
from sitl.autopilots.byte_links import UdpPeer
from sitl.autopilots.px4.autopilot import Px4
from sitl.autopilots.px4.parameters import Px4Parameters
from sitl.geometry.ned_frd import frd_from_flu, ned_frd_from_enu_flu, ned_from_enu
from sitl.geometry.quaternion import conjugate, rotate
from sitl.world.quadrotor import Quadrotor

pytest.importorskip("mavsdk", reason="MAVSDK is not installed")
from mavsdk import Autopilot as Firmware
from mavsdk import Configuration, Mavsdk
from mavsdk.plugins.action import Action
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage
from mavsdk.plugins.mocap import (
    AngularVelocityBody,
    Covariance,
    Mocap,
    Odometry,
    PositionBody,
    Quaternion,
    SpeedBody,
)
from mavsdk.plugins.offboard import Offboard, PositionNedYaw
from mavsdk.plugins.telemetry import FlightMode, LandedState, Telemetry

pytestmark = [pytest.mark.slow, pytest.mark.nightly, pytest.mark.real_time, pytest.mark.filterwarnings("ignore")]

STEP_S, SYS_STATUS = 0.004, 1
ORIGIN = (47.3977, 8.5456, 488.0)
VARIANCE = 0.02**2


class Flight:
    """Autopilot that flies in a thread of this process, with MAVSDK at the other end.

    The link is UDP, and the poses are the truth.
    """

    def __init__(self, name: str) -> None:
        self._end = UdpPeer(remote=None)
        vehicle = Quadrotor(1, 0.0)
        self.autopilot: Autopilot = (
            Px4(vehicle, self._end, Px4Parameters.load(), 1)
            if name == "px4"
            else ArduCopter(vehicle, self._end, ArduPilotParameters.load(), 1)
        )
        self.mavsdk = Mavsdk(Configuration.create_manual(233, 191, True))
        self._over = threading.Event()
        self._mocap: Any = None
        self._thread = threading.Thread(target=self._fly, daemon=True)
        self._thread.start()
        self.mavsdk.add_any_connection(f"udpout://127.0.0.1:{self._end.local_port}")
        system = self.mavsdk.first_autopilot(20.0)
        assert system is not None, "MAVSDK sees no autopilot"
        self.system = system
        system.enable_timesync()
        self.action = Action(system)
        self.offboard = Offboard(system)
        self.telemetry = Telemetry(system)
        self._mocap = Mocap(system)

    def close(self) -> None:
        self._over.set()
        self._thread.join(5.0)
        self.mavsdk.destroy()
        self._end.close()

    def ask_for(self, message: int, rate_hz: float) -> None:
        """Send SET_MESSAGE_INTERVAL."""
        fields = {"command": 511, "confirmation": 0, "param1": message, "param2": 1e6 / rate_hz}
        fields |= {f"param{n}": 0.0 for n in range(3, 8)} | {"target_system": 1, "target_component": 1}
        MavlinkDirect(self.system).send_message(MavlinkMessage("COMMAND_LONG", 233, 191, 1, 1, json.dumps(fields)))

    def until(self, what: str, holds: Callable[[], bool], seconds: float) -> None:
        end_s = time.monotonic() + seconds
        while not holds():
            assert time.monotonic() < end_s, f"not {what} within {seconds:g} s: {self.autopilot.texts[-5:]}"
            time.sleep(0.05)

    def _fly(self) -> None:
        next_s, turn = time.monotonic(), 0
        while not self._over.is_set():
            self.autopilot.step(time.monotonic())
            if self._mocap is not None and turn % 8 == 0:
                self._mocap.set_odometry(odometry(self.autopilot))
            turn += 1
            next_s = max(next_s + STEP_S, time.monotonic())
            time.sleep(max(next_s - time.monotonic(), 0.0))


def odometry(autopilot: Autopilot) -> Odometry:
    """Return the true odometry; MAVSDK stamps it with its own time."""
    t = autopilot.truth()
    velocity = frd_from_flu(rotate(conjugate(t.quat_wxyz), t.velocity))
    diagonal = [VARIANCE if row == column else 0.0 for row in range(6) for column in range(row, 6)]
    return Odometry(
        0,
        Odometry.MavFrame.LOCAL_FRD,
        PositionBody(*ned_from_enu(t.position)),
        Quaternion(*ned_frd_from_enu_flu(t.quat_wxyz)),
        SpeedBody(*velocity),
        AngularVelocityBody(0.0, 0.0, 0.0),
        Covariance(diagonal),
        Covariance(diagonal),
        0,
        Odometry.MavEstimatorType.VIO,
        100,
    )


def height_m(flight: Flight) -> float:
    """Return the height that MAVSDK reports."""
    return float(-flight.telemetry.position_velocity_ned().position.down_m)


def climb(flight: Flight) -> None:
    """Command 1.2 m above the pad, in OFFBOARD or GUIDED."""
    flight.offboard.set_position_ned(PositionNedYaw(0.0, 0.0, -1.2, 0.0))
    flight.offboard.start()


@pytest.fixture(params=["px4", "ardupilot"])
def flight(request: pytest.FixtureRequest) -> Iterator[Flight]:
    made = Flight(request.param)
    yield made
    made.close()


def test_mavsdk_arms_flies_and_lands(flight: Flight) -> None:
    px4 = isinstance(flight.autopilot, Px4)
    assert flight.system.autopilot_type() == (Firmware.PX4 if px4 else Firmware.ARDUPILOT)
    told = flight.telemetry
    flight.ask_for(SYS_STATUS, 5.0)  # ArduPilot sends only requested messages, and MAVSDK does not request this one
    told.set_rate_in_air(5.0)
    told.set_rate_position_velocity_ned(10.0)
    flight.until("a camera that is healthy", lambda: told.health().is_local_position_ok, 40.0)
    if not px4:  # an origin before the estimate is valid is lost, and it cannot be sent twice
        flight.until("all but an origin", lambda: "PreArm: Fence requires position" in flight.autopilot.texts, 60.0)
    flight.action.set_gps_global_origin(*ORIGIN)
    if px4:  # MAVSDK sends LOCAL_FRD only, which gives PX4 no heading: no Hold, but OFFBOARD needs no north
        climb(flight)
    flight.until("ready to arm", lambda: told.health().is_armable, 40.0)
    assert (told.armed(), told.landed_state()) == (False, LandedState.ON_GROUND)

    flight.action.arm()
    flight.until("armed", told.armed, 5.0)
    if not px4:  # GUIDED climbs by a command, and accepts a setpoint only in the air
        flight.action.set_takeoff_altitude(1.2)
        flight.action.takeoff()
        flight.until("at its height", lambda: height_m(flight) > 1.1, 20.0)
        climb(flight)
    flight.until("in the air", told.in_air, 20.0)
    flight.until("at its height", lambda: abs(height_m(flight) - 1.2) < 0.15, 20.0)
    assert told.flight_mode() == FlightMode.OFFBOARD
    flight.offboard.set_position_ned(PositionNedYaw(1.0, 0.5, -1.2, 0.0))
    flight.until("at its place", lambda: math.dist(flight.autopilot.truth().position, (0.5, 1.0, 1.2)) < 0.15, 20.0)
    seen = told.position_velocity_ned().position
    assert math.dist((seen.north_m, seen.east_m, seen.down_m), (1.0, 0.5, -1.2)) < 0.25

    flight.action.land()
    flight.until("landing", lambda: told.flight_mode() == FlightMode.LAND, 5.0)
    flight.until("on the ground", lambda: not told.in_air(), 30.0)
    flight.until("disarmed", lambda: not told.armed(), 20.0)
    assert flight.autopilot.truth().position[2] < 0.05
