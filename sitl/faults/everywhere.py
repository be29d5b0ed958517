"""What holds in every flight of the campaign, whatever the trouble."""

from __future__ import annotations

import numpy as np

from sitl.faults import measures
from sitl.faults.evidence import Evidence
from sitl.faults.telling import untold

CONTACT_M, FENCE_M = 1e-3, 0.30
AIRBORNE_M, UNATTENDED_S = 0.15, 60.0
_STEP_M, _SPEED_MPS, _PUSH_MPS2, _TURN_RADPS = 0.03, 0.06, 1e-3, 1e-3  # what single floats and 30 Hz may add
_INSIDE_M = 0.02
_TURN_S = 1.0 / 60.0
_PERIOD_S = 1.0 / 30.0  # of setpoints


def violations(e: Evidence, overshoot_m: float = FENCE_M) -> list[str]:
    """What was broken, in words with figures; empty for a flight that kept all of it. overshoot_m: of the fence, at most."""
    checks = (_contact, _numbers, _speed, _steps, _place, _authority, _disarm, _end, untold)
    told = (check(e) for check in checks)
    return [said for said in (*told, _fence(e, overshoot_m)) if said]


def _contact(e: Evidence) -> str:
    least_m = measures.clearance(e)
    return f"contact: clearance {least_m:.3f} m" if least_m < CONTACT_M else ""


def _fence(e: Evidence, most_m: float) -> str:
    out_m = measures.overshoot(e)
    return f"fence overshot by {out_m:.2f} m" if out_m > most_m else ""


def _numbers(e: Evidence) -> str:
    return f"{e.wire.not_finite} frames with NaN or infinity on the wire" if e.wire.not_finite else ""


def _speed(e: Evidence) -> str:
    w, limits = e.wire, e.limits
    speed = float(np.linalg.norm(w.velocity_mps, axis=1).max(initial=0.0))
    push = float(np.linalg.norm(w.acceleration_mps2, axis=1).max(initial=0.0))
    turn = float(np.abs(w.yaw_rate_radps).max(initial=0.0))
    if speed > limits.speed_mps + 1e-3:
        return f"setpoint of {speed:.2f} m/s"
    if push > limits.acceleration_mps2 + _PUSH_MPS2:
        return f"setpoint of {push:.2f} m/s²"
    return f"setpoint of {turn:.2f} rad/s" if turn > limits.yaw_rate_radps + _TURN_RADPS else ""


def _steps(e: Evidence) -> str:
    """From one setpoint to the next; a reset of the pose moves them with it, and so does a pilot that starts anew.

    Two that were sent a thirtieth of a second apart may arrive together, where the receiver comes late: the longer time counts,
    but of what their sender says no more than that.
    """
    w, limits = e.wire, e.limits
    dt = np.maximum(np.diff(w.setpoint_s), np.minimum(np.diff(w.setpoint_stamp_ms) / 1e3, _PERIOD_S))
    resets = w.odometry_s[1:][np.diff(w.reset_counter) != 0]
    near = [abs(w.setpoint_s[1:] - s) < 0.1 for s in resets]
    counted = (dt < 0.5) & ~np.logical_or.reduce(near) if near else dt < 0.5
    step = np.linalg.norm(np.diff(w.position_m, axis=0), axis=1) - limits.speed_mps * (dt + _TURN_S)
    change = np.linalg.norm(np.diff(w.velocity_mps, axis=0), axis=1) - limits.acceleration_mps2 * (dt + _TURN_S)
    if (step[counted] > _STEP_M).any():
        return f"setpoint jumps {float(step[counted].max()):.2f} m farther than allowed"
    return f"velocity jumps by {float(change[counted].max()):.2f} m/s too much" if (change[counted] > _SPEED_MPS).any() else ""


def _place(e: Evidence) -> str:
    """The pad lies below the inset's floor: what is under it is no violation over the pad."""
    w, limits = e.wire, e.limits
    low, high = np.array(limits.fence_min_m) + limits.inset_m, np.array(limits.fence_max_m) - limits.inset_m
    out = np.maximum(low - w.position_m, w.position_m - high)
    pad = np.hypot(w.position_m[:, 0], w.position_m[:, 1]) < 0.6
    out[pad, 2] = np.minimum(out[pad, 2], 0.0)
    worst_m = float(out.max(initial=0.0))
    return f"setpoint {worst_m:.2f} m out of the inset fence" if worst_m > _INSIDE_M else ""


def _authority(e: Evidence) -> str:
    count = int(measures.commands_once_known(e))
    return f"{count} mode or arm commands after the pilot took over" if count else ""


def _disarm(e: Evidence) -> str:
    """Asked for, or met, above the ground; what the pilot's own switch does is the pilot's."""
    height = e.position_m[:, 2]
    for order in e.wire.orders:
        stop = (order.command == 400 and order.first < 0.5) or (order.command == 185 and order.first > 0.5)
        if stop and np.interp(order.stamp_s, e.stamp_s, height) > AIRBORNE_M:
            return "asked for the motors to stop in the air"
    fell = e.armed[:-1] & ~e.armed[1:] & (height[:-1] > AIRBORNE_M)
    return "disarmed in the air" if fell.any() else ""


def _end(e: Evidence) -> str:
    """Down with motors off, in a pilot's hands, or not yet so long alone."""
    human = not e.ours[-1] and not e.landing[-1]
    unattended = bool(e.armed[-1]) and not human and e.end_s - e.onset_s > UNATTENDED_S - 1.0
    still = unattended and float(np.linalg.norm(np.diff(e.position_m[-int(30 / _TURN_S) :], axis=0), axis=1).sum()) < 3.0
    return "hovers armed and unattended" if still else ""
