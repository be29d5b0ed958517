"""Simulated ArduCopter with its scripted companion; all clocks are injected."""

from __future__ import annotations

import copy
import functools
import math
from typing import Any

from px4_rig import seconds_until
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from scripted_companion import Companion

from sitl.autopilots.ardupilot.autopilot import ArduCopter
from sitl.autopilots.ardupilot.parameters import ArduPilotParameters
from sitl.autopilots.byte_links import ByteEnd

__all__ = ["Copilot", "copter", "flying", "mode_of", "ready", "seconds_until"]

STABILIZE, ALT_HOLD, GUIDED, LOITER, LAND = 0, 2, 4, 5, 9
TAKEOFF, ARM, SET_MODE, INTERVAL = 22, 400, 176, 511
FOLLOWING, BLIND = 0x33F, 0x25
PLACE_SPEED_YAW = 2496
SPEED_ONLY, PLACE_ONLY = 0b110111000111, 0b110111111000
ASKED = {1: 5.0, 24: 0.0, 31: 50.0, 32: 30.0, 85: 10.0, 193: 10.0, 245: 5.0}


class Copilot(Companion):
    """Companion with system id 233, which the indoor parameters name as the ground station."""

    system = 233

    def __init__(self, parameters: Any = None, seed: int = 1, **more: float) -> None:
        super().__init__(parameters, seed, **more)
        self._codec = mavlink.MAVLink(None, self.system, 191)
        self.type_mask = PLACE_SPEED_YAW
        self.pose_frame = (mavlink.MAV_FRAME_LOCAL_FRD, mavlink.MAV_FRAME_BODY_FRD)
        self.heartbeats_as: int | None = None
        for message_id, rate_hz in ASKED.items():
            if rate_hz:
                self.command(INTERVAL, message_id, 1e6 / rate_hz)

    def _make(self, end: ByteEnd, parameters: Any, seed: int) -> ArduCopter:
        return ArduCopter(self.vehicle, end, parameters or ArduPilotParameters.load(), seed)

    @property
    def copter(self) -> ArduCopter:
        assert isinstance(self.autopilot, ArduCopter)
        return self.autopilot

    def send_heartbeat(self) -> None:
        self._codec.srcSystem = self.heartbeats_as or self.system
        super().send_heartbeat()
        self._codec.srcSystem = self.system

    def set_mode(self, custom_mode: int) -> int:
        return self.ask(SET_MODE, 1, custom_mode)

    def climb(self, height: float) -> int:
        return self.ask(TAKEOFF, 0, 0, 0, 0, 0, 0, height)

    def move(self, vx: float, vy: float, vz: float = 0.0) -> None:
        """Stream a velocity only."""
        self.type_mask = SPEED_ONLY
        self.setpoint = lambda _t: (0.0, 0.0, 0.0, vx, vy, vz, 0.0, 0.0, 0.0, 0.0, 0.0)

    def stay(self, x: float, y: float, z: float) -> None:
        """Stream a position only."""
        self.type_mask = PLACE_ONLY
        self.setpoint = lambda _t: (x, y, z, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def flags(self) -> int:
        return int(self.last["EKF_STATUS_REPORT"].flags)

    @property
    def speed(self) -> float:
        return math.hypot(*self.vehicle.velocity[:2])

    def ready(self) -> None:
        """Wait until the pose is fused, send the origin, and wait for PREARM."""
        assert self.run(5.0, lambda: "EKF_STATUS_REPORT" in self.last and self.flags == FOLLOWING)
        self.send_origin()
        assert self.run(20.0, lambda: "SYS_STATUS" in self.last and self.prearm)

    def take_off(self, height: float = 1.2) -> None:
        """Arm, and climb by a take-off command."""
        self.ready()
        assert self.set_mode(GUIDED) == 0
        assert self.run(2.0, lambda: self.mode == GUIDED)
        assert self.arm() == 0
        assert self.climb(height) == 0
        assert self.run(15.0, lambda: self.away_from(0.0, 0.0, -height) < 0.08)
        self.run(1.0)


def copter(seed: int = 1, **changes: float) -> Copilot:
    p = ArduPilotParameters.load()
    for name, value in changes.items():
        p.set(name, value)
    return Copilot(p, seed)


def ready(seed: int = 1, **changes: float) -> Copilot:
    c = copter(seed, **changes)
    c.ready()
    return c


@functools.lru_cache(maxsize=8)
def taken_off(seed: int) -> Copilot:
    """Return a hovering vehicle; flown once per seed, tests get copies."""
    c = copter(seed)
    c.take_off()
    return c


def flying(seed: int = 1, **changes: float) -> Copilot:
    c = copy.deepcopy(taken_off(seed))
    for name, value in changes.items():
        c.copter.parameters.set(name, value)
    return c


def mode_of(c: Copilot) -> str:
    return c.copter.truth().mode
