"""Continuity of setpoints: limits of each step, and position consistent with velocity."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uav_recon.safety.envelope import Envelope, Vec3
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_LONGEST_S = 0.5  #: refuse: a longer pause allows no larger step: the autopilot gives up on such a stream
#: refuse: a position step beyond the speed limit by more, summed over setpoints: enough for a late clock
_MAX_POSITION_STEP_M = 0.02
_MAX_VELOCITY_STEP_MPS = 0.05  #: refuse: a velocity step beyond the acceleration limit by more, likewise
_MAX_HEADING_STEP_DEG = math.degrees(0.03)  #: refuse: a heading step beyond the yaw rate limit by more, likewise
_MAX_OFF_VELOCITY_M = 0.02  #: refuse: a position farther from where the velocities lead: they would not tell of it
_MAX = (_MAX_POSITION_STEP_M, _MAX_VELOCITY_STEP_MPS, _MAX_HEADING_STEP_DEG, _MAX_OFF_VELOCITY_M)
_CODES = (ReasonCode.POSITION_STEP, ReasonCode.VELOCITY_STEP, ReasonCode.HEADING_STEP, ReasonCode.POSITION_OFF_VELOCITY)


@dataclass(frozen=True, slots=True)
class ClearedMotion:
    """A cleared setpoint in plain floats."""

    at_s: float
    position_m: Vec3
    velocity_mps: Vec3
    yaw_rad: float
    pitch_down_rad: float


@dataclass(frozen=True, slots=True)
class ContinuityCheck:
    """The excess over the limits of position, velocity and heading (m, m/s, degrees).

    beyond: what was used and not made up for since; the slack is for a late clock, and is not granted again for each setpoint.
    astray_m: difference of the positions from where the velocities lead.
    """

    beyond: Vec3 = (0.0, 0.0, 0.0)
    astray_m: Vec3 = (0.0, 0.0, 0.0)

    def after(self, last: ClearedMotion, motion: ClearedMotion, envelope: Envelope) -> tuple[ContinuityCheck, Reason | None]:
        """Return the check after one more setpoint, and its fault, None if there is none."""
        dt_s, braking_mps2 = min(max(motion.at_s - last.at_s, 0.0), _LONGEST_S), envelope.max_acceleration_mps2
        turn_deg = math.degrees(abs(math.remainder(motion.yaw_rad - last.yaw_rad, math.tau)))
        steps = math.dist(motion.position_m, last.position_m), math.dist(motion.velocity_mps, last.velocity_mps), turn_deg
        limits = envelope.max_speed_mps, braking_mps2, math.degrees(envelope.max_yaw_rate_radps)
        a, b, c = (max(old + step - dt_s * limit, 0.0) for old, step, limit in zip(self.beyond, steps, limits, strict=True))
        ways = zip(self.astray_m, last.position_m, motion.position_m, last.velocity_mps, motion.velocity_mps, strict=True)
        x, y, z = (old + q - p - (u + v) / 2.0 * dt_s for old, p, q, u, v in ways)
        off_m = math.hypot(x, y, z)
        left = max(1.0 - braking_mps2 * dt_s**2 / 4.0 / max(off_m, 1e-12), 0.0)  # what the acceleration limit allows is ignored
        taken = zip((a, b, c, off_m * left), (*steps, off_m), _MAX, _CODES, strict=True)
        faults = [Reason(code, (step,)) for beyond, step, most, code in taken if not beyond <= most]
        return ContinuityCheck((a, b, c), (x * left, y * left, z * left)), faults[0] if faults else None
