"""How a motion begins: at rest, or out of a motion that is being flown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.motion.time_scaling import KEPT_S, STEP_S
from uav_recon.types.frames import FloatArray
from uav_recon.types.trajectory import Setpoint, Trajectory

AT_REST = 1e-3  # m/s and rad/s


@dataclass(frozen=True, slots=True, eq=False)
class InitialState:
    """What would be flown if nothing new came: rows (N, 5) of x, y, z, yaw, pitch each STEP_S, and from the last one on the
    same step over and over. A new way takes over at the last row. Row 0 is one step before the start, for the differences;
    the new motion has its way from row ``left`` on, and what is before is the old motion's own."""

    rows: FloatArray
    drift: FloatArray
    left: int

    @staticmethod
    def resting(start: Setpoint, lead: int) -> InitialState:
        """Stand for ``lead`` steps: so far the smoothing of the new way reaches back."""
        here = np.array([*start.position_m, start.yaw_rad, start.camera_pitch_down_rad])
        return InitialState(np.tile(here, (lead + 2, 1)), np.zeros(5), 1)

    @staticmethod
    def leaving(flying: Trajectory, at: int, lead: int, most: FloatArray) -> InitialState:
        """Out of sample ``at`` of a trajectory; its acceleration there dies away, from ``most`` (5,) within the whole lead."""
        first = max(at - round(KEPT_S / STEP_S), 0)
        past = columns(flying, first - 1, at + 1)
        around = columns(flying, at - 1, at + 2)
        velocity = (around[2] - around[0]) / (2 * STEP_S)
        acceleration = (around[2] - 2 * around[1] + around[0]) / STEP_S**2
        end_s = lead * STEP_S * min(max(float(np.max(np.abs(acceleration) / most)), 1.0 / lead), 1.0)
        now_s = np.arange(1, lead + 1)[:, None] * STEP_S
        t = np.minimum(now_s, end_s)
        drift = velocity + 0.5 * acceleration * end_s
        ahead = past[-1] + velocity * t + acceleration * (0.5 * t**2 - t**3 / (6 * end_s)) + drift * (now_s - t)
        return InitialState(np.vstack([past, ahead]), drift * STEP_S, at - first + 1)

    @property
    def place(self) -> FloatArray:
        """Where the new way takes over (5,)."""
        return np.asarray(self.rows[-1])

    @property
    def velocity(self) -> FloatArray:
        """At what rate (5,) per second."""
        return np.asarray(self.drift / STEP_S)

    @property
    def is_moving(self) -> bool:
        """Whether there is any motion to leave."""
        return bool(np.abs(self.velocity).max() > AT_REST)

    def continued(self, count: int) -> FloatArray:
        """The rows with ``count`` more of the same drift."""
        return np.vstack([self.rows, self.rows[-1] + self.drift * np.arange(1, count + 1)[:, None]])


def columns(trajectory: Trajectory, begin: int, end: int) -> FloatArray:
    """Rows (N, 5) of samples begin..end; after the last one it rests, and the one before the first follows from its rates."""
    last = len(trajectory.yaw_rad) - 1
    index = np.clip(np.arange(begin, end), 0, last)
    angles = (trajectory.yaw_rad[index], trajectory.camera_pitch_down_rad[index])
    rows = np.column_stack([trajectory.position_m[index], *angles])
    if begin < 0 < last:
        rows[0, :3] = trajectory.position_m[1] - 2 * STEP_S * trajectory.velocity_mps[0]
        rows[0, 3] = trajectory.yaw_rad[1] - 2 * STEP_S * trajectory.yaw_rate_radps[0]
        rows[0, 4] = 2 * trajectory.camera_pitch_down_rad[0] - trajectory.camera_pitch_down_rad[1]
    return rows
