"""Initial state of a motion: at rest, or out of a motion that is being flown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uav_recon.motion.time_scaling import KEPT_S, STEP_S
from uav_recon.types.frames import FloatArray
from uav_recon.types.trajectory import Setpoint, Trajectory

AT_REST = 1e-3  # m/s and rad/s


@dataclass(frozen=True, slots=True, eq=False)
class InitialState:
    """The motion that would be flown without a new path.

    rows: (N, 5) x, y, z, yaw, pitch each STEP_S. After the last row, each step adds ``drift`` (5,). A new path takes over at
    the last row. Row 0 is one step before the start, for the differences. The new motion has its path from row ``left`` on; the
    rows before are those of the old motion.
    """

    rows: FloatArray
    drift: FloatArray
    left: int

    @staticmethod
    def at_rest(start: Setpoint, lead: int) -> InitialState:
        """Return a rest of ``lead`` steps, as far back as the smoothing of the new path reaches."""
        here = np.array([*start.position_m, start.yaw_rad, start.camera_pitch_down_rad])
        return InitialState(np.tile(here, (lead + 2, 1)), np.zeros(5), 1)

    @staticmethod
    def in_motion(flying: Trajectory, at: int, lead: int, most: FloatArray) -> InitialState:
        """Return the state that leaves a trajectory at its sample ``at``.

        The acceleration there decreases to zero: from ``most`` (5,) within the whole lead, from less sooner.
        """
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
        """Position (5,) where the new path takes over."""
        return np.asarray(self.rows[-1])

    @property
    def velocity(self) -> FloatArray:
        """Rate (5,) per second at which the new path takes over."""
        return np.asarray(self.drift / STEP_S)

    @property
    def is_moving(self) -> bool:
        """True if there is a motion to leave."""
        return bool(np.abs(self.velocity).max() > AT_REST)

    def continued(self, count: int) -> FloatArray:
        """Return the rows followed by ``count`` more with the same drift."""
        return np.vstack([self.rows, self.rows[-1] + self.drift * np.arange(1, count + 1)[:, None]])


def columns(trajectory: Trajectory, begin: int, end: int) -> FloatArray:
    """Return rows (N, 5) of the samples begin to end - 1 of a trajectory.

    After its last sample it rests. The row before the first sample follows from the rates there.
    """
    last = len(trajectory.yaw_rad) - 1
    index = np.clip(np.arange(begin, end), 0, last)
    angles = (trajectory.yaw_rad[index], trajectory.camera_pitch_down_rad[index])
    rows = np.column_stack([trajectory.position_m[index], *angles])
    if begin < 0 < last:
        rows[0, :3] = trajectory.position_m[1] - 2 * STEP_S * trajectory.velocity_mps[0]
        rows[0, 3] = trajectory.yaw_rad[1] - 2 * STEP_S * trajectory.yaw_rate_radps[0]
        rows[0, 4] = 2 * trajectory.camera_pitch_down_rad[0] - trajectory.camera_pitch_down_rad[1]
    return rows
