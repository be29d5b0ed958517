"""Time scaling of a trajectory.

p(tau(t)) has velocity v tau' and acceleration a tau'^2 + v tau''.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.frames import AnyArray, FloatArray
from uav_recon.types.trajectory import Trajectory

STEP_S = 0.02
KEPT_S = 0.5  # part of the old motion, before the instant at which it is left, that a new trajectory keeps
BRAKE_RISE_S = 0.2  # rise time of braking: the hardest has 9 m/s³ of jerk, within what ArduCopter shapes (PSC_JERK_NE 10)
HARDEST_SLEW = 50.0  # 1/s², slew limit of tau'': even a very slow motion takes some ten samples to stop

Pace = tuple[FloatArray, FloatArray, FloatArray]  # (N,) each: time in the old trajectory, and its first and second derivative


@kernel
def _slow_down(old: AnyArray, first_s: float, acceleration: float, yaw_acceleration: float, played: AnyArray) -> int:
    """Brake by replaying the old samples at a falling rate; return the number of filled rows.

    played: rows (tau, tau', tau''). old: (N, 5) of speed, tangential and normal acceleration, absolute yaw rate, and yaw
    acceleration in the direction of that rate. tau'' is as low as the bounds on both accelerations allow at this sample
    (tangential a tau'^2 + v tau''), but rises and, by the square-root law, falls with bounded jerk. Ends at tau' = 0 or with
    the old samples.
    """
    last_s = (len(old) - 1) * STEP_S
    tau, rate, change = first_s, 1.0, 0.0
    for n in range(len(played)):
        played[n] = tau, rate, change
        if rate <= 0.0 or tau >= last_s:
            return n + 1
        at = min(tau / STEP_S + rate, len(old) - 1.000001)  # where the change takes effect
        low = int(at)
        speed, along, across, turning, old_yaw_acceleration = old[low] + (at - low) * (old[low + 1] - old[low])
        speed, turning = max(speed, 0.01), max(turning, 0.01)
        held = np.sqrt(max(acceleration**2 - (across * rate * rate) ** 2, 0.0))
        bound = max(-(held + along * rate * rate) / speed, -(yaw_acceleration + old_yaw_acceleration * rate * rate) / turning)
        slew = min(acceleration / speed / BRAKE_RISE_S, yaw_acceleration / turning / BRAKE_RISE_S, HARDEST_SLEW)
        wanted = max(min(bound, 0.0), -np.sqrt(2.0 * slew * rate))
        change = max(wanted, change - slew * STEP_S)
        slower = rate + change * STEP_S
        slower = slower if slower > 1e-3 else 0.0
        tau += 0.5 * (rate + slower) * STEP_S
        rate = slower
    return len(played)


def braking(
    trajectory: Trajectory, first_s: float, acceleration: float, yaw_acceleration: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the fastest stop from ``first_s`` into a trajectory, as a Pace.

    The rate falls from 1 to 0.
    """
    velocity, turning = trajectory.velocity_mps, trajectory.yaw_rate_radps
    speed = np.linalg.norm(velocity, axis=1)
    total2 = np.sum(trajectory.acceleration_mps2**2, axis=1)
    along = np.sum(trajectory.acceleration_mps2 * velocity, axis=1) / np.maximum(speed, 1e-6)
    across = np.sqrt(np.maximum(total2 - along**2, 0.0))
    old_yaw_acceleration = np.gradient(turning, trajectory.step_s) * np.sign(turning)
    played = np.zeros((int(4 * (trajectory.duration_s - first_s) / STEP_S) + 250, 3))
    old = np.stack([speed, along, across, np.abs(turning), old_yaw_acceleration], axis=1)
    count = _slow_down(old, first_s, acceleration, yaw_acceleration, played)
    played[count - 1, 1:] = 0.0
    return played[:count, 0] - first_s, played[:count, 1], played[:count, 2]


def rescaled(trajectory: Trajectory, first_s: float, pace: Pace, start_s: float, identifier: int) -> Trajectory:
    """Return the trajectory from ``first_s`` on at another pace, without captures.

    first_s: seconds into the trajectory.
    """
    played_s, rate, change = pace
    grid = np.arange(len(trajectory.yaw_rad)) * trajectory.step_s

    def old(values: FloatArray) -> FloatArray:
        columns = [np.interp(first_s + played_s, grid, column) for column in np.atleast_2d(values.T)]
        return np.asarray(columns[0] if values.ndim == 1 else np.stack(columns, axis=1), dtype=np.float64)

    velocity = old(trajectory.velocity_mps)
    return dataclasses.replace(
        trajectory,
        start_s=start_s,
        position_m=old(trajectory.position_m),
        velocity_mps=velocity * rate[:, None],
        acceleration_mps2=old(trajectory.acceleration_mps2) * rate[:, None] ** 2 + velocity * change[:, None],
        yaw_rad=old(trajectory.yaw_rad),
        yaw_rate_radps=old(trajectory.yaw_rate_radps) * rate,
        camera_pitch_down_rad=old(trajectory.camera_pitch_down_rad),
        views_s=np.zeros(0),
        identifier=identifier,
    )


def joined(flying: Trajectory, at: int, braked: Trajectory, flown: Trajectory) -> Trajectory:
    """Join ``flying`` until its sample ``at``, the stop ``braked`` and ``flown`` from rest.

    It begins KEPT_S before ``at``.
    """
    first = max(at - round(KEPT_S / STEP_S), 0)

    def rows(name: str) -> FloatArray:
        old: FloatArray = getattr(flying, name)[first:at]
        return np.concatenate([old, getattr(braked, name)[:-1], getattr(flown, name)])

    before_s = (at - first + len(braked.yaw_rad) - 1) * STEP_S
    return Trajectory(
        flying.start_s + first * STEP_S, STEP_S, rows("position_m"), rows("velocity_mps"), rows("acceleration_mps2"),
        rows("yaw_rad"), rows("yaw_rate_radps"), rows("camera_pitch_down_rad"), flown.views_s + before_s, flown.map_epoch,
        flown.identifier, flown.clearance_m,
    )  # fmt: skip
