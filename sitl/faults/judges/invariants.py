"""General limits, which hold in every flight of the campaign, whatever the fault."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.faults.flight_evidence import Bools, FlightEvidence
from sitl.faults.injectors.base import TAKEN_OVER
from sitl.faults.judges import reaction_metrics
from sitl.faults.judges.statustext_checks import statustext_missing

Indices = NDArray[np.int64]

CONTACT_M = 1e-3
AIRBORNE_M = 0.15
UNATTENDED_S = 60.0
# tolerances for single-precision values and for 30 Hz
_STEP_M = 0.03
_SPEED_MPS = 0.06
_PUSH_MPS2 = 1e-3
_TURN_RADPS = 1e-3
_HEADING_RAD = 0.03
_INSIDE_M = 0.02
_TURN_S = 1.0 / 60.0
_PERIOD_S = 1.0 / 30.0  # between setpoints
_WHILE_S = 0.4


@dataclass(frozen=True)
class Room:
    """Limits of a flight on its surroundings.

    clear_m: least clearance to the scene (m). overshoot_m: greatest distance outside the fence (m).
    """

    clear_m: float = 0.10
    overshoot_m: float = 0.30


USUAL = Room()


def violations(e: FlightEvidence, room: Room = USUAL) -> list[str]:
    """Return a message with values for each violated limit; empty if none was violated."""
    checks = (_numbers, _speed, _steps, _place, _authority, _disarm, _end, statustext_missing)
    found = (check(e) for check in checks)
    return [said for said in (_clear(e, room.clear_m), *found, _fence(e, room.overshoot_m)) if said]


def _clear(e: FlightEvidence, min_m: float) -> str:
    kept_m = reaction_metrics.clearance(e)
    if kept_m < CONTACT_M:
        return f"contact: clearance {kept_m:.3f} m"
    return f"clearance {kept_m:.3f} m of {min_m:.2f}" if kept_m < min_m - 1e-9 else ""


def _fence(e: FlightEvidence, max_m: float) -> str:
    out_m = reaction_metrics.overshoot(e)
    return f"fence overshot by {out_m:.2f} m" if out_m > max_m else ""


def _numbers(e: FlightEvidence) -> str:
    return f"{e.wire.not_finite} frames with NaN or infinity on the wire" if e.wire.not_finite else ""


def _speed(e: FlightEvidence) -> str:
    w, limits = e.wire, e.limits
    speed = float(np.linalg.norm(w.velocity_mps, axis=1).max(initial=0.0))
    push = float(np.linalg.norm(w.acceleration_mps2, axis=1).max(initial=0.0))
    turn = float(np.abs(w.yaw_rate_radps).max(initial=0.0))
    if speed > limits.speed_mps + 1e-3:
        return f"setpoint of {speed:.2f} m/s"
    if push > limits.acceleration_mps2 + _PUSH_MPS2:
        return f"setpoint of {push:.2f} m/s²"
    return f"setpoint of {turn:.2f} rad/s" if turn > limits.yaw_rate_radps + _TURN_RADPS else ""


def _steps(e: FlightEvidence) -> str:
    """Check each pair of successive setpoints, and each pair _WHILE_S apart.

    The tolerance of single frames does not accumulate over a dozen of them.
    """
    stamps = e.wire.setpoint_s
    k = np.arange(max(len(stamps) - 1, 0))
    later = np.searchsorted(stamps, stamps + _WHILE_S - 1e-6)
    begun = np.flatnonzero(later < len(stamps))
    return _leaps(e, k, k + 1) or _leaps(e, begun, later[begun])


def _leaps(e: FlightEvidence, i: Indices, j: Indices) -> str:
    """Check the steps from setpoints i (P,) to the later setpoints j (P,).

    Steps across a discontinuity are not checked. Two setpoints sent 1/30 s apart may arrive together if the receiver is
    late. So the longer of the arrival interval and the sender's interval counts, but of the sender's interval at most
    _PERIOD_S for each setpoint.
    """
    w, limits = e.wire, e.limits
    breaks = np.append(0, np.cumsum(_restarted(e)))
    i, j = i[breaks[i] == breaks[j]], j[breaks[i] == breaks[j]]
    told_s = (w.setpoint_stamp_ms[j] - w.setpoint_stamp_ms[i]) / 1e3
    dt = np.maximum(w.setpoint_s[j] - w.setpoint_s[i], np.minimum(told_s, _PERIOD_S * (j - i)))
    step = np.linalg.norm(w.position_m[j] - w.position_m[i], axis=1) - limits.speed_mps * (dt + _TURN_S)
    change = np.linalg.norm(w.velocity_mps[j] - w.velocity_mps[i], axis=1) - limits.acceleration_mps2 * (dt + _TURN_S)
    turned = reaction_metrics.turned_rad(w.yaw_rad[i], w.yaw_rad[j]) if len(w.yaw_rad) else np.zeros(len(i))
    turn = turned - limits.yaw_rate_radps * (dt + _TURN_S)
    within = f" within {float(np.median(dt)):.2f} s" if len(dt) else ""
    if (step > _STEP_M).any():
        return f"setpoint jumps {float(step.max()):.2f} m farther than allowed{within}"
    if (turn > _HEADING_RAD).any():
        return f"heading jumps by {float(np.degrees(turn.max())):.0f} degrees too much{within}"
    return f"velocity jumps by {float(change.max()):.2f} m/s too much{within}" if (change > _SPEED_MPS).any() else ""


def _restarted(e: FlightEvidence) -> Bools:
    """Return a mask (N - 1,) of the discontinuities, one value for each setpoint but the first.

    A discontinuity is a pose reset, which moves the setpoint, or the first setpoint after a pause of 0.5 s, as of a
    restarted pilot.
    """
    w = e.wire
    again: Bools = np.diff(w.setpoint_s) >= 0.5
    for reset_s in w.odometry_s[1:][np.diff(w.reset_counter) != 0]:
        again |= np.abs(w.setpoint_s[1:] - reset_s) < 0.1
    return again


def _place(e: FlightEvidence) -> str:
    """Check that the setpoints are inside the inset fence.

    The pad lies below the floor of the inset fence, so over the pad a setpoint below that floor is no violation.
    """
    w, limits = e.wire, e.limits
    low, high = np.array(limits.fence_min_m) + limits.inset_m, np.array(limits.fence_max_m) - limits.inset_m
    out = np.maximum(low - w.position_m, w.position_m - high)
    pad = np.hypot(w.position_m[:, 0], w.position_m[:, 1]) < 0.6
    out[pad, 2] = np.minimum(out[pad, 2], 0.0)
    worst_m = float(out.max(initial=0.0))
    return f"setpoint {worst_m:.2f} m out of the inset fence" if worst_m > _INSIDE_M else ""


def _authority(e: FlightEvidence) -> str:
    count = int(reaction_metrics.commands_once_known(e))
    return f"{count} mode or arm commands after the pilot took over" if count else ""


def _disarm(e: FlightEvidence) -> str:
    """Check that the product neither requests nor causes disarming above the ground.

    Disarming by the human pilot's own switch is not counted.
    """
    height = e.position_m[:, 2] - e.standing_m
    for order in e.wire.orders:
        stop = (order.command == 400 and order.first < 0.5) or (order.command == 185 and order.first > 0.5)
        if stop and np.interp(order.stamp_s, e.stamp_s, height) > AIRBORNE_M:
            return "disarm command in the air"
    fell = e.armed[:-1] & ~e.armed[1:] & (height[:-1] > AIRBORNE_M)
    return "disarmed in the air" if fell.any() else ""


def _end(e: FlightEvidence) -> str:
    """Check that the vehicle does not hover armed and unattended.

    It must have landed with motors off, be controlled by a human pilot, or not yet have hovered for UNATTENDED_S.
    """
    human = TAKEN_OVER in e.notes and not e.ours[-1] and not e.landing[-1]
    operator_lost = bool(e.armed[-1]) and not human and e.end_s - e.onset_s > UNATTENDED_S - 1.0
    still = operator_lost and float(np.linalg.norm(np.diff(e.position_m[-int(30 / _TURN_S) :], axis=0), axis=1).sum()) < 3.0
    return "hovers armed and unattended" if still else ""
