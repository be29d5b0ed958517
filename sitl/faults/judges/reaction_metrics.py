"""Metrics of a flight: functions from the evidence to one number.

They return inf where the awaited event never came.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from sitl.faults.flight_evidence import F64, Bools, FlightEvidence
from sitl.faults.wire_capture import MODE_OR_ARM, CapturedCommand, WireCapture

Measure = Callable[[FlightEvidence], float]
_STILL_MPS = 0.02  # a setpoint below this speed is at rest
_BRAKING_MPS2 = 0.8  # a smaller mean deceleration is not braking
_RESTING_MPS = 0.12  # a vehicle below this speed is at rest; gusts included
_ASIDE_M = 0.2  # from the flown path, whose corners are rounded (0.15 m measured)
_BACK_M = 0.3  # from the position left
# a setpoint above one of these translates or rotates
_LED_MPS = 0.05
_LED_RADPS = 0.05
_BEFORE_S = 1.5  # of earlier setpoints, for the vehicle's delay
_FLOWN_M = 2.0  # from the pad; every completed mission goes at least 3.4 m
_ARM = 400
_SET_MODE = 176


def held_after(late_s: float = 0.0) -> Measure:
    """Return a measure of the seconds from late_s after the fault to the start of braking."""

    def measure(e: FlightEvidence) -> float:
        w, from_s = e.wire, e.onset_s + late_s
        speed = np.linalg.norm(w.velocity_mps, axis=1)
        after = np.flatnonzero((w.setpoint_s >= from_s) & (speed <= _STILL_MPS))
        gone = e.since(~e.ours, from_s)  # the time at which another mode ended the motion
        if not len(after):
            return gone
        rest = k = best = int(after[0])
        while k > 0 and w.setpoint_s[k - 1] >= from_s and speed[k - 1] > speed[k] + 1e-4:
            k -= 1
            if speed[k] >= _BRAKING_MPS2 * (w.setpoint_s[rest] - w.setpoint_s[k]) - _STILL_MPS:
                best = k
        return min(max(float(w.setpoint_s[best]) - from_s, 0.0), gone)

    return measure


def stopped_within(late_s: float = 0.0) -> Measure:
    """Return a measure of the true path (m) from late_s after the fault to rest or landing."""

    def measure(e: FlightEvidence) -> float:
        from_s = e.onset_s + late_s
        level = np.linalg.norm(e.velocity_mps[:, :2], axis=1) < _RESTING_MPS
        until_s = from_s + min(e.since(level, from_s), e.end_s - from_s)
        way = e.position_m[(e.stamp_s >= from_s) & (e.stamp_s <= until_s)]
        return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())

    return measure


def landing_after(late_s: float = 0.0) -> Measure:
    """Return a measure of the seconds from late_s after the fault to the landing mode."""
    return lambda e: e.since(e.landing | ~e.armed, e.onset_s + late_s)


def landing_after_a_stop(e: FlightEvidence) -> float:
    """Return the seconds from the last moving setpoint to the landing mode; inf for never.

    A moving setpoint is one with a horizontal velocity or a yaw rotation.
    """
    w, landing_s = e.wire, e.onset_s + landing_after()(e)
    led = _leads(w, np.hypot(w.velocity_mps[:, 0], w.velocity_mps[:, 1]))
    led_s = w.setpoint_s[led & (w.setpoint_s >= e.onset_s) & (w.setpoint_s <= landing_s)]
    return landing_s - (float(led_s[-1]) if len(led_s) else e.onset_s)


def _leads(w: WireCapture, speed_mps: F64) -> Bools:
    """Return a mask of the setpoints (N,), with speed_mps (N,), that translate or rotate."""
    led: Bools = speed_mps > _LED_MPS
    if len(w.yaw_rad):
        led[1:] |= turned_rad(w.yaw_rad[:-1], w.yaw_rad[1:]) > _LED_RADPS * np.diff(w.setpoint_s)
    return led


def turned_rad(one: F64, other: F64) -> F64:
    """Return the angles (N,), 0 to pi, between headings."""
    turned: F64 = np.abs(np.remainder(other - one + np.pi, 2.0 * np.pi) - np.pi)
    return turned


def stopped_after(speed_mps: float) -> Measure:
    """Return a measure of the seconds until the vehicle is slower than speed_mps.

    It is the true speed along the direction of travel at the beginning of the fault; motion backwards is allowed. The
    measure is inf if that never happens, and if the fault never began.
    """

    def measure(e: FlightEvidence) -> float:
        after = e.velocity_mps[e.stamp_s >= e.onset_s]
        if not len(after):
            return math.inf
        along = after[0]
        onward_mps = e.velocity_mps @ (along / max(float(np.linalg.norm(along)), 1e-9))
        return e.since(onward_mps < speed_mps, e.onset_s)

    return measure


def off_its_way(e: FlightEvidence) -> float:
    """Return the greatest horizontal distance (m) of the true position from the setpoints' path.

    Only the time from the fault until the vehicle leaves our mode counts.
    """
    w, until_s = e.wire, e.onset_s + e.since(~e.ours, e.onset_s)
    line = w.position_m[(w.setpoint_s >= e.onset_s - _BEFORE_S) & (w.setpoint_s <= until_s), :2]
    flown = e.position_m[(e.stamp_s >= e.onset_s) & (e.stamp_s < until_s), :2]
    if not len(line) or not len(flown):
        return math.inf
    return max(float(np.linalg.norm(line - place, axis=1).min()) for place in flown)


def disarmed_after() -> Measure:
    """Return a measure of the seconds from the fault until the motors stop."""
    return lambda e: e.since(~e.armed, e.onset_s)


def drift_landing(e: FlightEvidence) -> float:
    """Return the horizontal distance (m) from the position at the fault to the landing position."""
    k = int(np.searchsorted(e.stamp_s, e.onset_s))
    return float(np.linalg.norm(e.position_m[-1, :2] - e.position_m[k, :2])) if e.onset_s < math.inf else math.inf


def height_at_landing(e: FlightEvidence) -> float:
    """Return the greatest height (m) above the pad before the first landing mode."""
    until_s = e.onset_s + e.since(e.landing, e.onset_s)
    return float((e.position_m[:, 2] - e.position_m[0, 2])[e.stamp_s <= until_s].max(initial=0.0))


def rests_at(e: FlightEvidence) -> float:
    """Return the final height (m) above the pad's floor; inf while armed."""
    return math.inf if e.armed[-1] else float(e.position_m[-1, 2])


def longest_gap(for_s: float = math.inf) -> Measure:
    """Return a measure of the longest time (s) between setpoints.

    Only the time from the fault until the vehicle lands or no longer follows setpoints counts, at most for_s.
    """

    def measure(e: FlightEvidence) -> float:
        until_s = e.onset_s + min(for_s, e.since(~e.ours, e.onset_s), e.end_s - e.onset_s)
        stamps = e.wire.setpoint_s
        inside = stamps[(stamps >= e.onset_s - 0.1) & (stamps <= until_s)]
        return float(np.diff(np.append(inside, until_s)).max()) if len(inside) else math.inf

    return measure


def slowest_second(e: FlightEvidence) -> float:
    """Return the fewest setpoints in any second since the fault began.

    Only the time in which the vehicle follows them counts.
    """
    until_s = e.onset_s + min(e.since(~e.ours, e.onset_s), e.end_s - e.onset_s)
    starts = np.arange(e.onset_s, until_s - 1.0, 0.1)
    if not len(starts):
        return math.inf
    stamps = e.wire.setpoint_s
    return float((np.searchsorted(stamps, starts + 1.0) - np.searchsorted(stamps, starts)).min())


def longest_gap_arrived(e: FlightEvidence) -> float:
    """Return the longest time (s) between setpoints at the autopilot since the fault began.

    Only the time in which the vehicle follows them counts.
    """
    until_s = e.onset_s + min(e.since(~e.ours, e.onset_s), e.end_s - e.onset_s)
    inside = e.arrived_s[(e.arrived_s >= e.onset_s - 0.1) & (e.arrived_s <= until_s)]
    return float(np.diff(np.append(inside, until_s)).max()) if len(inside) else math.inf


def slowest_ten_seconds_arrived(e: FlightEvidence) -> float:
    """Return the lowest arrival rate (1/s) of setpoints at the autopilot in any ten seconds.

    Only the time from the fault until the vehicle no longer follows them counts.
    """
    until_s = e.onset_s + min(e.since(~e.ours, e.onset_s), e.end_s - e.onset_s)
    starts = np.arange(e.onset_s, until_s - 10.0, 0.1)
    counts = np.searchsorted(e.arrived_s, starts + 10.0) - np.searchsorted(e.arrived_s, starts)
    return float(counts.min()) / 10.0 if len(counts) else 0.0


def noted(name: str) -> Measure:
    """Return a measure of a value that an injector noted; inf if it noted none."""
    return lambda e: e.notes.get(name, math.inf)


def from_note(name: str, measure: Measure) -> Measure:
    """Return a measure from the time that an injector noted under a name; NaN if it noted none."""
    return lambda e: measure(dataclasses.replace(e, onset_s=e.notes[name])) if name in e.notes else math.nan


def failsafes(e: FlightEvidence) -> float:
    """Return the number of failsafes of the autopilot."""
    return float(len(e.failsafes))


def moves_again_after(late_s: float) -> Measure:
    """Return a measure of the seconds from the end of a fault to the next moving setpoint.

    The fault lasts late_s. A moving setpoint translates or rotates.
    """

    def measure(e: FlightEvidence) -> float:
        w, from_s = e.wire, e.onset_s + late_s
        moving = w.setpoint_s[(w.setpoint_s >= from_s) & _leads(w, np.linalg.norm(w.velocity_mps, axis=1))]
        return float(moving[0]) - from_s if len(moving) else math.inf

    return measure


def setpoint_jump(e: FlightEvidence) -> float:
    """Return the longest distance (m) between successive setpoints since the fault began.

    Only the time in which the vehicle follows them counts.
    """
    w = e.wire
    until_s = e.onset_s + e.since(~e.ours, e.onset_s)
    k = np.flatnonzero((w.setpoint_s >= e.onset_s) & (w.setpoint_s <= until_s))
    return float(np.linalg.norm(np.diff(w.position_m[k], axis=0), axis=1).max()) if len(k) > 1 else 0.0


def retreat_after(e: FlightEvidence) -> float:
    """Return the seconds from the fault to the first motion after a rest.

    It returns inf if that motion does not go back along the flown path.
    """
    w = e.wire
    speed, after = np.linalg.norm(w.velocity_mps, axis=1), w.setpoint_s >= e.onset_s
    still = np.flatnonzero(after & (speed <= _STILL_MPS))
    moving = np.flatnonzero(after & (speed > 0.05))
    moving = moving[moving > still[0]] if len(still) else moving[:0]
    begun_s = float(w.setpoint_s[moving[0]]) if len(moving) else math.inf
    return begun_s - e.onset_s if len(moving) and _goes_back(e, begun_s) else math.inf


def _goes_back(e: FlightEvidence, from_s: float) -> bool:
    """Return whether the true position moves and stays on the earlier path until it lands."""
    until_s = from_s + e.since(e.landing | ~e.armed, from_s)
    way = e.position_m[e.armed & (e.stamp_s <= from_s)]
    gone = e.position_m[(e.stamp_s >= from_s) & (e.stamp_s <= until_s)]
    aside = [float(np.linalg.norm(way - place, axis=1).min()) for place in gone]
    return max(aside) <= _ASIDE_M and float(np.linalg.norm(gone - way[-1], axis=1).max()) >= _BACK_M


def commands(after_s: float = 0.0, kinds: frozenset[int] = MODE_OR_ARM) -> Measure:
    """Return a measure of the product's mode and arm commands from after_s after the fault on."""
    return lambda e: float(sum(o.command in kinds and o.stamp_s > e.onset_s + after_s for o in e.wire.orders))


def commands_once_known(e: FlightEvidence) -> float:
    """Return the number of mode and arm commands after the product received a foreign mode.

    It receives it with the first heartbeat in a mode that it had not requested.
    """
    return float(len(_after_takeover(e)))


def _after_takeover(e: FlightEvidence) -> list[CapturedCommand]:
    """Return the mode and arm commands after a takeover by a human pilot.

    A takeover leads out of our mode or out of a landing.
    """
    theirs = e.armed & ~e.ours & ~e.landing
    k = np.flatnonzero(theirs[1:] & (e.ours | (e.landing & e.armed))[:-1]) + 1
    if not len(k):
        return []
    known = [stamp_s for stamp_s, _, _ in e.heard if stamp_s >= e.stamp_s[k[0]]]
    return [o for o in e.wire.orders if o.command in MODE_OR_ARM and known and o.stamp_s > known[0] + 0.02]


def mode_lost(e: FlightEvidence) -> float:
    """Return the number of armed turns in another mode than the one that the pilot chose.

    It returns inf if the pilot chose none.
    """
    after = np.flatnonzero(~e.ours & ~e.landing & (e.stamp_s >= e.onset_s))
    if not len(after):
        return math.inf
    chosen = e.mode[int(after[0])]
    return float(sum(armed and m != chosen for armed, m in zip(e.armed[after[0] :], e.mode[after[0] :], strict=True)))


def position_mode(e: FlightEvidence) -> float:
    """Return the number of turns in a mode that needs stick input by a pilot."""
    return float(sum(m in ("POSCTL", "ALTCTL", "MANUAL", "STABILIZED", "LOITER", "ALT_HOLD") for m in e.mode[_onset(e) :]))


def streams_after(e: FlightEvidence) -> float:
    """Return the seconds from the fault to the last setpoint sent."""
    return max(float(e.wire.setpoint_s[-1]) - e.onset_s, 0.0) if len(e.wire.setpoint_s) else 0.0


def speed_from(late_s: float) -> Measure:
    """Return a measure of the greatest setpoint speed (m/s) from late_s after the fault on.

    Only the time in which the vehicle follows setpoints counts.
    """

    def measure(e: FlightEvidence) -> float:
        from_s, w = e.onset_s + late_s, e.wire
        until_s = from_s + e.since(~e.ours, from_s)
        k = (w.setpoint_s >= from_s) & (w.setpoint_s <= until_s)
        return float(np.linalg.norm(w.velocity_mps[k], axis=1).max(initial=0.0))

    return measure


def clearance(e: FlightEvidence) -> float:
    """Return the least true clearance (m) to the scene and to obstacles of the fault."""
    return min(e.clearance_m, e.min_obstacle_distance_m)


def lands_beside(e: FlightEvidence) -> float:
    """Return the least distance (m) of the hull to the fault's obstacle during the landing.

    It returns -inf without a landing.
    """
    down = e.landing & e.armed
    return float(e.obstacle_distance_m[down].min()) if down.any() else -math.inf


def stopped_short(e: FlightEvidence) -> float:
    """Return the least distance (m) to the fault's obstacle until the vehicle first rests.

    It returns -inf if the vehicle never rests.
    """
    rest_s = e.since(np.linalg.norm(e.velocity_mps, axis=1) < _RESTING_MPS, e.onset_s)
    until = (e.stamp_s >= e.onset_s) & (e.stamp_s <= e.onset_s + rest_s)
    return float(e.obstacle_distance_m[until].min(initial=math.inf)) if rest_s < math.inf else -math.inf


def overshoot(e: FlightEvidence) -> float:
    """Return the greatest distance (m) of the vehicle's centre outside the fence."""
    airborne = e.position_m[e.armed & e.product_responsible]
    if not len(airborne):
        return 0.0
    return float(max(np.maximum(e.limits.fence_min_m - airborne, airborne - e.limits.fence_max_m).max(), 0.0))


def landing_after_leaving(e: FlightEvidence) -> float:
    """Return the seconds from leaving the fence horizontally to the autopilot's landing mode.

    It returns inf for a vehicle that never left the fence.
    """
    low, high = np.array(e.limits.fence_min_m), np.array(e.limits.fence_max_m)
    out = ((e.position_m < low) | (e.position_m > high))[:, :2].any(axis=1) & e.ours & (e.stamp_s >= e.onset_s)
    return e.since(e.landing, float(e.stamp_s[int(np.argmax(out))])) if out.any() else math.inf


def back_inside(e: FlightEvidence) -> float:
    """Return the longest uninterrupted time (s) outside the inset fence.

    It counts the horizontal position from the fault to the landing.
    """
    low, high = np.array(e.limits.fence_min_m) + e.limits.inset_m, np.array(e.limits.fence_max_m) - e.limits.inset_m
    out = ((e.position_m < low) | (e.position_m > high))[:, :2].any(axis=1) & e.ours & (e.stamp_s >= e.onset_s)
    longest = run = 0
    for outside in out.tolist():
        run = run + 1 if outside else 0
        longest = max(longest, run)
    return longest * float(np.diff(e.stamp_s).mean())


def armed_at_all(e: FlightEvidence) -> float:
    """Return 1 if the vehicle was ever armed, else 0."""
    return float(e.armed.any())


def arm_tries(e: FlightEvidence) -> float:
    """Return the number of arm commands."""
    return float(len(tries_s(e)))


def forced(e: FlightEvidence) -> float:
    """Return the number of commands that force the autopilot to arm or disarm."""
    return float(sum(o.command == _ARM and o.second == 21196.0 for o in e.wire.orders))


def last_try_after(e: FlightEvidence) -> float:
    """Return the seconds from the first arm command to the last."""
    tries = tries_s(e)
    return tries[-1] - tries[0] if tries else math.inf


def first_arm(e: FlightEvidence) -> float:
    """Return the seconds from the start of the product to its first arm command."""
    tries = tries_s(e)
    return tries[0] - float(e.stamp_s[0]) if tries else math.inf


def tries_s(e: FlightEvidence) -> list[float]:
    """Return the times of the arm commands."""
    return [o.stamp_s for o in e.wire.orders if o.command == _ARM and o.first > 0.5]


def motors_ran(e: FlightEvidence) -> float:
    """Return the seconds for which the vehicle was armed."""
    return float(np.count_nonzero(e.armed) * np.diff(e.stamp_s).mean())


def battery_left(e: FlightEvidence) -> float:
    """Return the state of charge at the end, 0 to 1."""
    return float(e.charge[-1])


def from_pad(e: FlightEvidence) -> float:
    """Return the horizontal distance (m) from the pad to the position at the end."""
    return float(np.hypot(*e.position_m[-1, :2]))


def relaunched(e: FlightEvidence) -> float:
    """Return the number of turns of following setpoints after a landing had begun."""
    first_s = e.since(e.landing, e.onset_s)
    return float((e.ours & (e.stamp_s > e.onset_s + first_s)).sum())


def unfinished(e: FlightEvidence) -> float:
    """Return 0 if the vehicle flew at least _FLOWN_M from the pad and came back, else 1."""
    away_m = np.hypot(e.position_m[:, 0], e.position_m[:, 1]).max()
    return float(bool(not_back(e)) or away_m < _FLOWN_M)


def ended_for(*codes: str) -> Measure:
    """Return a measure that is 1 if the reason for the flight's end has one of these codes.

    The reason is the one that the product gave; without any, the measure is 1, too. Otherwise it is 0.
    """
    return lambda e: float(not (e.stop_codes and set(codes).isdisjoint(e.stop_codes)))


def not_back(e: FlightEvidence) -> float:
    """Return 0 if the flight ended disarmed on the pad with no autopilot failsafe, else 1."""
    return float(bool(e.armed[-1]) or from_pad(e) > 0.5 or bool(e.failsafes) or not e.armed.any())


def asked_to_land(e: FlightEvidence) -> float:
    """Return the seconds from the fault to the product's own command to land."""
    asked = [o.stamp_s for o in e.wire.orders if o.command in (_SET_MODE, 21) and o.stamp_s >= e.onset_s]
    return asked[0] - e.onset_s if asked else math.inf


def _onset(e: FlightEvidence) -> int:
    return int(np.searchsorted(e.stamp_s, e.onset_s))
