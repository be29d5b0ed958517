"""Pose of the depth imager on the body: on a fixed mount, or on a gimbal that tilts it."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from operator import itemgetter
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

    @property
    def measured_until_s(self) -> float:
        """Instant until which the angle is measured; after it, it is extrapolated."""
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

    @property
    def measured_until_s(self) -> float:
        """Infinity: the angle is constant."""
        return math.inf


class GimbalMount:
    """A camera tilted about the body's y axis by the angle that the vehicle measures.

    position_body_m: (3,) of the depth imager, taken as the tilt axis. Between two measurements the angle is interpolated, and
    after the newest extrapolated for ``ahead_s``; farther than ``stale_s`` from any measurement it is unknown.
    """

    def __init__(
        self, position_body_m: FloatArray, vehicle: Channel[VehicleState], stale_s: float = 0.3, ahead_s: float = 0.1
    ) -> None:
        self._position_body_m = position_body_m
        self._vehicle = vehicle
        self._stale_s = stale_s
        self._ahead_s = ahead_s
        self._sequence = 0
        self._angles: deque[tuple[float, float]] = deque(maxlen=256)  # stamp, pitch down

    def observe(self) -> None:
        """Store the newest measured angle."""
        sequence = self._vehicle.sequence()
        if sequence == self._sequence:
            return
        self._sequence = sequence
        state = self._vehicle.latest()
        if state is None or not math.isfinite(state.camera_pitch_down_rad + state.camera_pitch_s):
            return
        if state.camera_pitch_s > self.measured_until_s:
            self._angles.append((state.camera_pitch_s, state.camera_pitch_down_rad))

    @property
    def measured_until_s(self) -> float:
        """Stamp of the newest measurement."""
        return self._angles[-1][0] if self._angles else -math.inf

    def body_from_depth(self, stamp_s: float) -> Pose | None:
        """Return the pose at an instant, from the measured angles around it."""
        after = bisect_right(self._angles, stamp_s, key=itemgetter(0))
        around = [self._angles[k] for k in (after - 1, after) if 0 <= k < len(self._angles)]
        near = [pair for pair in around if abs(pair[0] - stamp_s) <= self._stale_s]
        if not near:
            return None
        (start_s, start_rad), (end_s, end_rad) = near[0], near[-1]
        if end_s > start_s:
            rate_radps = (end_rad - start_rad) / (end_s - start_s)
        else:
            rate_radps = self._rate_radps if after == len(self._angles) else 0.0
        passed_s = min(stamp_s - start_s, end_s - start_s + self._ahead_s)
        return body_from_camera(self._position_body_m, start_rad + passed_s * rate_radps)

    @property
    def _rate_radps(self) -> float:
        """Rate between the two newest measurements."""
        if len(self._angles) < 2:
            return 0.0
        (start_s, start_rad), (end_s, end_rad) = self._angles[-2], self._angles[-1]
        return (end_rad - start_rad) / (end_s - start_s)
