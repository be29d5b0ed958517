"""Pose of the depth imager on the body: on a fixed mount, or on a gimbal that tilts it."""

from __future__ import annotations

import math
from collections import deque
from typing import Protocol

from uav_recon.interfaces import Channel
from uav_recon.types.camera import body_from_camera
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose
from uav_recon.types.vehicle import VehicleState


class Mount(Protocol):
    """Gives the pose of the depth imager on the body. No call blocks."""

    def observe(self) -> None:
        """Read new measurements of the mount's angle; called every step."""
        ...

    def body_from_depth(self, stamp_s: float) -> Pose | None:
        """Return the pose of the depth imager on the body at an instant, None if it is not known."""
        ...


class FixedMount:
    """A camera that does not move on the body."""

    def __init__(self, body_from_depth: Pose) -> None:
        self._body_from_depth = body_from_depth

    def observe(self) -> None:
        """Do nothing: the angle is constant."""

    def body_from_depth(self, stamp_s: float) -> Pose | None:
        """Return the constant pose."""
        return self._body_from_depth


class GimbalMount:
    """A camera tilted about the body's y axis by the angle that the vehicle measures.

    position_body_m: (3,) of the depth imager, taken as the tilt axis. Between two measurements the angle is interpolated;
    farther than ``stale_s`` from any measurement it is unknown.
    """

    def __init__(self, position_body_m: FloatArray, vehicle: Channel[VehicleState], stale_s: float = 0.3) -> None:
        self._position_body_m = position_body_m
        self._vehicle = vehicle
        self._stale_s = stale_s
        self._sequence = 0
        self._angles: deque[tuple[float, float]] = deque(maxlen=256)  # stamp, pitch down

    def observe(self) -> None:
        """Store the newest measured angle."""
        sequence = self._vehicle.sequence()
        if sequence == self._sequence:
            return
        self._sequence = sequence
        state = self._vehicle.latest()
        if state is None or not math.isfinite(state.camera_pitch_down_rad + state.stamp_s):
            return
        if not self._angles or state.stamp_s > self._angles[-1][0]:
            self._angles.append((state.stamp_s, state.camera_pitch_down_rad))

    def body_from_depth(self, stamp_s: float) -> Pose | None:
        """Return the pose at an instant, from the measured angles around it."""
        before = next((pair for pair in reversed(self._angles) if pair[0] <= stamp_s), None)
        after = next((pair for pair in self._angles if pair[0] > stamp_s), None)
        near = [pair for pair in (before, after) if pair is not None and abs(pair[0] - stamp_s) <= self._stale_s]
        if not near:
            return None
        (start_s, start_rad), (end_s, end_rad) = near[0], near[-1]
        share = (stamp_s - start_s) / (end_s - start_s) if end_s > start_s else 0.0
        return body_from_camera(self._position_body_m, start_rad + share * (end_rad - start_rad))
