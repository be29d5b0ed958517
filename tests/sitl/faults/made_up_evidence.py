"""A flight that never was: up at 1 m/s, along, down again, with nothing wrong; tests spoil it in one place."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from sitl.faults.flight_evidence import FlightEvidence, GuardLimits
from sitl.faults.wire_capture import CapturedCommand, WireCapture

DT_S, ONSET_S, END_S = 1.0 / 30.0, 5.0, 20.0
LIMITS = GuardLimits((-2.0, -3.0, -0.1), (8.0, 3.0, 2.7), 0.3, 1.2, 2.0, 1.0)
BOOT_S = -40.0


def evidence(**changes: Any) -> FlightEvidence:
    """Climbs for 2 s, flies 0.5 m/s along x for 8 s, lands from 15 s on, is down and disarmed at 18 s."""
    t = np.arange(0.0, END_S, DT_S)
    climb = np.interp(t, [0.0, 0.5, 2.0, 2.5, 15.0, 15.2, 17.7, 17.9], [0.0, 0.5, 0.5, 0.0, 0.0, -0.37, -0.37, 0.0])
    along = np.interp(t, [2.0, 2.5, 10.0, 10.5], [0.0, 0.5, 0.5, 0.0])
    speed = np.stack([along, np.zeros_like(t), climb], axis=1)
    place = np.cumsum(speed, axis=0) * DT_S
    armed = t < 18.0
    mode = tuple("OFFBOARD" if s < 15.0 else "LAND" for s in t)
    plain = FlightEvidence(
        onset_s=ONSET_S, end_s=END_S, stamp_s=t, position_m=place, velocity_mps=speed, yaw_rad=turning(t), armed=armed,
        mode=mode, hull_s=t[:400], hull_m=np.full(400, 0.5), obstacle_distance_m=np.full(len(t), math.inf),
        standing_m=np.zeros(len(t)), charge=np.full(len(t), 0.8), failsafes=(), texts=(),
        wire=wire(t[t < 15.0], place[t < 15.0], speed[t < 15.0]), arrived_s=t[t < 15.0],
        heard=tuple((s, 6 << 16, True) for s in t), limits=LIMITS,
        boot_s=BOOT_S, reported=((6.0, ("refused",)), (15.1, ())),
    )  # fmt: skip
    return dataclasses.replace(plain, **changes)


def turning(t: Any) -> Any:
    """Heading (rad), 0.7 rad/s from 4 s on."""
    return 0.7 * np.maximum(t - 4.0, 0.0)


def wire(t: Any, place: Any, speed: Any, **changes: Any) -> WireCapture:
    """The setpoints and poses of such a flight; inset 0.3 m above the floor but over the pad, so it climbs there."""
    zero = np.zeros_like(place)
    said = WireCapture(
        setpoint_s=t, setpoint_stamp_ms=np.floor((t - BOOT_S) * 1e3),
        position_m=place, velocity_mps=speed, acceleration_mps2=zero, yaw_rate_radps=np.zeros(len(t)),
        odometry_s=t, odometry_m=place + 0.01,
        odometry_yaw_rad=np.remainder(turning(t) + 0.01 + np.pi, 2.0 * np.pi) - np.pi,
        odometry_stamp_us=(t - BOOT_S) * 1e6, reset_counter=np.zeros(len(t)),
        orders=(CapturedCommand(0.5, 176, 1.0, 6.0), CapturedCommand(0.8, 400, 1.0, 0.0), CapturedCommand(15.0, 176, 1.0, 4.0)),
        texts=((6.0, "holding"), (15.1, "landing")), not_finite=0,
    )  # fmt: skip
    return dataclasses.replace(said, **changes)


def rewired(e: FlightEvidence, **changes: Any) -> FlightEvidence:
    """The same flight with other words on the wire."""
    return dataclasses.replace(e, wire=dataclasses.replace(e.wire, **changes))


def spoilt(array: Any, index: Any, value: Any) -> Any:
    """A copy with one place changed."""
    copy = np.array(array)
    copy[index] = value
    return copy
