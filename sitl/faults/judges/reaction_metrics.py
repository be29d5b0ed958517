"""Figures of a flight: each a function from the evidence to one number; inf where what was waited for never came."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from sitl.faults.flight_evidence import F64, Bools, FlightEvidence
from sitl.faults.wire_capture import MODE_OR_ARM, CapturedCommand, WireCapture

Measure = Callable[[FlightEvidence], float]
_STILL_MPS = 0.02  # of a setpoint
_BRAKING_MPS2 = 0.8  # what slows down more gently than this, on the mean, is flying on
_RESTING_MPS = 0.12  # of the vehicle, gusts included
_ASIDE_M, _BACK_M = 0.2, 0.3  # of the way flown, whose corners are rounded (0.15 m measured); of the place left
_LED_MPS, _LED_RADPS = 0.05, 0.05  # of a setpoint that leads anywhere, or turns
_BEFORE_S = 1.5  # of setpoints, for a vehicle that follows late
_FLOWN_M = 2.0  # from the pad: a mission that goes anywhere goes farther, 3.4 m at least
_ARM, _SET_MODE = 400, 176


def held_after(late_s: float = 0.0) -> Measure:
    """Seconds from the trouble (and so much) to the setpoint at which braking to rest begins."""

    def measure(e: FlightEvidence) -> float:
        w, from_s = e.wire, e.onset_s + late_s
        speed = np.linalg.norm(w.velocity_mps, axis=1)
        after = np.flatnonzero((w.setpoint_s >= from_s) & (speed <= _STILL_MPS))
        gone = e.since(~e.ours, from_s)  # another mode has ended the motion
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
    """Metres of true path from the trouble (and so much) until the vehicle rests or lands."""

    def measure(e: FlightEvidence) -> float:
        from_s = e.onset_s + late_s
        level = np.linalg.norm(e.velocity_mps[:, :2], axis=1) < _RESTING_MPS
        until_s = from_s + min(e.since(level, from_s), e.end_s - from_s)
        way = e.position_m[(e.stamp_s >= from_s) & (e.stamp_s <= until_s)]
        return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())

    return measure


def landing_after(late_s: float = 0.0) -> Measure:
    """Seconds from the trouble (and so much) to the autopilot's landing mode."""
    return lambda e: e.since(e.landing | ~e.armed, e.onset_s + late_s)


def landing_after_a_stop(e: FlightEvidence) -> float:
    """Seconds from the last setpoint that led anywhere, level, or turned, to the autopilot's landing mode; inf for never."""
    w, landing_s = e.wire, e.onset_s + landing_after()(e)
    led = _leads(w, np.hypot(w.velocity_mps[:, 0], w.velocity_mps[:, 1]))
    led_s = w.setpoint_s[led & (w.setpoint_s >= e.onset_s) & (w.setpoint_s <= landing_s)]
    return landing_s - (float(led_s[-1]) if len(led_s) else e.onset_s)


def _leads(w: WireCapture, speed_mps: F64) -> Bools:
    """Which setpoints (N,), of these speeds, lead anywhere, or turn."""
    led: Bools = speed_mps > _LED_MPS
    if len(w.yaw_rad):
        led[1:] |= turned_rad(w.yaw_rad[:-1], w.yaw_rad[1:]) > _LED_RADPS * np.diff(w.setpoint_s)
    return led


def turned_rad(one: F64, other: F64) -> F64:
    """Angles (N,), 0 to pi, between headings."""
    turned: F64 = np.abs(np.remainder(other - one + np.pi, 2.0 * np.pi) - np.pi)
    return turned


def stopped_after(speed_mps: float) -> Measure:
    """Seconds from the trouble until the vehicle truly goes on more slowly along the way it had then; it may swing back. inf
    for never, and where the trouble never came.
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
    """Farthest (m), level, that the vehicle truly is from the line of its setpoints, from the trouble on, while it is ours."""
    w, until_s = e.wire, e.onset_s + e.since(~e.ours, e.onset_s)
    line = w.position_m[(w.setpoint_s >= e.onset_s - _BEFORE_S) & (w.setpoint_s <= until_s), :2]
    flown = e.position_m[(e.stamp_s >= e.onset_s) & (e.stamp_s < until_s), :2]
    if not len(line) or not len(flown):
        return math.inf
    return max(float(np.linalg.norm(line - place, axis=1).min()) for place in flown)


def disarmed_after() -> Measure:
    """Seconds from the trouble until the motors stand."""
    return lambda e: e.since(~e.armed, e.onset_s)


def drift_landing(e: FlightEvidence) -> float:
    """Metres, level, from where the vehicle was at the trouble to where it came down."""
    k = int(np.searchsorted(e.stamp_s, e.onset_s))
    return float(np.linalg.norm(e.position_m[-1, :2] - e.position_m[k, :2])) if e.onset_s < math.inf else math.inf


def rests_at(e: FlightEvidence) -> float:
    """Metres over the pad's floor at which it stands at the end; inf while its motors run."""
    return math.inf if e.armed[-1] else float(e.position_m[-1, 2])


def longest_gap(for_s: float = math.inf) -> Measure:
    """Longest seconds between setpoints from the trouble on, while the vehicle follows them and until it lands."""

    def measure(e: FlightEvidence) -> float:
        until_s = e.onset_s + min(for_s, e.since(~e.ours, e.onset_s), e.end_s - e.onset_s)
        stamps = e.wire.setpoint_s
        inside = stamps[(stamps >= e.onset_s - 0.1) & (stamps <= until_s)]
        return float(np.diff(np.append(inside, until_s)).max()) if len(inside) else math.inf

    return measure


def slowest_second(e: FlightEvidence) -> float:
    """Fewest setpoints in any second from the trouble on, while the vehicle follows them."""
    until_s = e.onset_s + min(e.since(~e.ours, e.onset_s), e.end_s - e.onset_s)
    starts = np.arange(e.onset_s, until_s - 1.0, 0.1)
    if not len(starts):
        return math.inf
    stamps = e.wire.setpoint_s
    return float((np.searchsorted(stamps, starts + 1.0) - np.searchsorted(stamps, starts)).min())


def longest_gap_arrived(e: FlightEvidence) -> float:
    """Longest seconds between setpoints at the autopilot from the trouble on, while the vehicle follows them."""
    until_s = e.onset_s + min(e.since(~e.ours, e.onset_s), e.end_s - e.onset_s)
    inside = e.arrived_s[(e.arrived_s >= e.onset_s - 0.1) & (e.arrived_s <= until_s)]
    return float(np.diff(np.append(inside, until_s)).max()) if len(inside) else math.inf


def slowest_ten_seconds_arrived(e: FlightEvidence) -> float:
    """Fewest setpoints a second at the autopilot, over any ten seconds from the trouble on, while the vehicle follows them."""
    until_s = e.onset_s + min(e.since(~e.ours, e.onset_s), e.end_s - e.onset_s)
    starts = np.arange(e.onset_s, until_s - 10.0, 0.1)
    counts = np.searchsorted(e.arrived_s, starts + 10.0) - np.searchsorted(e.arrived_s, starts)
    return float(counts.min()) / 10.0 if len(counts) else 0.0


def noted(name: str) -> Measure:
    """What an injector measured itself; inf if it came to nothing."""
    return lambda e: e.notes.get(name, math.inf)


def failsafes(e: FlightEvidence) -> float:
    """How often the autopilot had to act by itself."""
    return float(len(e.failsafes))


def moves_again_after(late_s: float) -> Measure:
    """Seconds from the end of a trouble of late_s to the first setpoint that moves, or turns."""

    def measure(e: FlightEvidence) -> float:
        w, from_s = e.wire, e.onset_s + late_s
        moving = w.setpoint_s[(w.setpoint_s >= from_s) & _leads(w, np.linalg.norm(w.velocity_mps, axis=1))]
        return float(moving[0]) - from_s if len(moving) else math.inf

    return measure


def setpoint_jump(e: FlightEvidence) -> float:
    """Longest metres between one setpoint and the next, from the trouble on, while the vehicle follows them."""
    w = e.wire
    until_s = e.onset_s + e.since(~e.ours, e.onset_s)
    k = np.flatnonzero((w.setpoint_s >= e.onset_s) & (w.setpoint_s <= until_s))
    return float(np.linalg.norm(np.diff(w.position_m[k], axis=0), axis=1).max()) if len(k) > 1 else 0.0


def retreat_after(e: FlightEvidence) -> float:
    """Seconds from the trouble to the first motion after a rest, where that goes back along the way; inf for one elsewhere."""
    w = e.wire
    speed, after = np.linalg.norm(w.velocity_mps, axis=1), w.setpoint_s >= e.onset_s
    still = np.flatnonzero(after & (speed <= _STILL_MPS))
    moving = np.flatnonzero(after & (speed > 0.05))
    moving = moving[moving > still[0]] if len(still) else moving[:0]
    begun_s = float(w.setpoint_s[moving[0]]) if len(moving) else math.inf
    return begun_s - e.onset_s if len(moving) and _goes_back(e, begun_s) else math.inf


def _goes_back(e: FlightEvidence, from_s: float) -> bool:
    """Whether the vehicle truly leaves the place where it is, and the way that it flew to there nowhere until it lands."""
    until_s = from_s + e.since(e.landing | ~e.armed, from_s)
    way = e.position_m[e.armed & (e.stamp_s <= from_s)]
    gone = e.position_m[(e.stamp_s >= from_s) & (e.stamp_s <= until_s)]
    aside = [float(np.linalg.norm(way - place, axis=1).min()) for place in gone]
    return max(aside) <= _ASIDE_M and float(np.linalg.norm(gone - way[-1], axis=1).max()) >= _BACK_M


def commands(after_s: float = 0.0, kinds: frozenset[int] = MODE_OR_ARM) -> Measure:
    """Mode and arm commands of the product from so long after the trouble on."""
    return lambda e: float(sum(o.command in kinds and o.stamp_s > e.onset_s + after_s for o in e.wire.orders))


def commands_once_known(e: FlightEvidence) -> float:
    """Mode and arm commands after the first heartbeat that told the product of a mode it had not asked for."""
    return float(len(_after_takeover(e)))


def _after_takeover(e: FlightEvidence) -> list[CapturedCommand]:
    """Out of our mode or out of a landing: a pilot may want the vehicle back from either."""
    theirs = e.armed & ~e.ours & ~e.landing
    k = np.flatnonzero(theirs[1:] & (e.ours | (e.landing & e.armed))[:-1]) + 1
    if not len(k):
        return []
    known = [stamp_s for stamp_s, _, _ in e.heard if stamp_s >= e.stamp_s[k[0]]]
    return [o for o in e.wire.orders if o.command in MODE_OR_ARM and known and o.stamp_s > known[0] + 0.02]


def mode_lost(e: FlightEvidence) -> float:
    """Turns in which the autopilot was armed in another mode than the one that the pilot chose; inf if none was chosen."""
    after = np.flatnonzero(~e.ours & ~e.landing & (e.stamp_s >= e.onset_s))
    if not len(after):
        return math.inf
    chosen = e.mode[int(after[0])]
    return float(sum(armed and m != chosen for armed, m in zip(e.armed[after[0] :], e.mode[after[0] :], strict=True)))


def position_mode(e: FlightEvidence) -> float:
    """Turns in a mode that wants a pilot's hands."""
    return float(sum(m in ("POSCTL", "ALTCTL", "MANUAL", "STABILIZED", "LOITER", "ALT_HOLD") for m in e.mode[_onset(e) :]))


def streams_after(e: FlightEvidence) -> float:
    """Seconds from the trouble to the last setpoint on the wire."""
    return max(float(e.wire.setpoint_s[-1]) - e.onset_s, 0.0) if len(e.wire.setpoint_s) else 0.0


def speed_from(late_s: float) -> Measure:
    """Fastest setpoint (m/s) from so long after the trouble on, while the vehicle follows them."""

    def measure(e: FlightEvidence) -> float:
        from_s, w = e.onset_s + late_s, e.wire
        until_s = from_s + e.since(~e.ours, from_s)
        k = (w.setpoint_s >= from_s) & (w.setpoint_s <= until_s)
        return float(np.linalg.norm(w.velocity_mps[k], axis=1).max(initial=0.0))

    return measure


def clearance(e: FlightEvidence) -> float:
    """Least true clearance (m) to the scene and to what appeared in it."""
    return min(e.clearance_m, e.min_obstacle_distance_m)


def lands_beside(e: FlightEvidence) -> float:
    """Least metres between the hull and what appeared, while it comes down; -inf for never."""
    down = e.landing & e.armed
    return float(e.obstacle_distance_m[down].min()) if down.any() else -math.inf


def stopped_short(e: FlightEvidence) -> float:
    """Least metres to what appeared until the vehicle first rests after it did; -inf if it never does."""
    rest_s = e.since(np.linalg.norm(e.velocity_mps, axis=1) < _RESTING_MPS, e.onset_s)
    until = (e.stamp_s >= e.onset_s) & (e.stamp_s <= e.onset_s + rest_s)
    return float(e.obstacle_distance_m[until].min(initial=math.inf)) if rest_s < math.inf else -math.inf


def overshoot(e: FlightEvidence) -> float:
    """Farthest (m) out of the fence, of the vehicle's middle."""
    airborne = e.position_m[e.armed & e.product_responsible]
    if not len(airborne):
        return 0.0
    return float(max(np.maximum(e.limits.fence_min_m - airborne, airborne - e.limits.fence_max_m).max(), 0.0))


def landing_after_leaving(e: FlightEvidence) -> float:
    """Seconds from leaving the fence itself, level, to the autopilot's landing mode; inf for a vehicle that never left."""
    low, high = np.array(e.limits.fence_min_m), np.array(e.limits.fence_max_m)
    out = ((e.position_m < low) | (e.position_m > high))[:, :2].any(axis=1) & e.ours & (e.stamp_s >= e.onset_s)
    return e.since(e.landing, float(e.stamp_s[int(np.argmax(out))])) if out.any() else math.inf


def back_inside(e: FlightEvidence) -> float:
    """Longest seconds without a break outside the inset fence before the landing, after the trouble."""
    low, high = np.array(e.limits.fence_min_m) + e.limits.inset_m, np.array(e.limits.fence_max_m) - e.limits.inset_m
    out = ((e.position_m < low) | (e.position_m > high))[:, :2].any(axis=1) & e.ours & (e.stamp_s >= e.onset_s)
    longest = run = 0
    for outside in out.tolist():
        run = run + 1 if outside else 0
        longest = max(longest, run)
    return longest * float(np.diff(e.stamp_s).mean())


def armed_at_all(e: FlightEvidence) -> float:
    """1 if the motors ever ran."""
    return float(e.armed.any())


def arm_tries(e: FlightEvidence) -> float:
    """How often arming was asked for."""
    return float(len(tries_s(e)))


def forced(e: FlightEvidence) -> float:
    """Commands that force the autopilot to arm or disarm."""
    return float(sum(o.command == _ARM and o.second == 21196.0 for o in e.wire.orders))


def last_try_after(e: FlightEvidence) -> float:
    """Seconds from the first arm command to the last."""
    tries = tries_s(e)
    return tries[-1] - tries[0] if tries else math.inf


def first_arm(e: FlightEvidence) -> float:
    """Seconds from the start of the product to its first arm command."""
    tries = tries_s(e)
    return tries[0] - float(e.stamp_s[0]) if tries else math.inf


def tries_s(e: FlightEvidence) -> list[float]:
    """Instants of the arm commands."""
    return [o.stamp_s for o in e.wire.orders if o.command == _ARM and o.first > 0.5]


def motors_ran(e: FlightEvidence) -> float:
    """Seconds for which the motors ran."""
    return float(np.count_nonzero(e.armed) * np.diff(e.stamp_s).mean())


def battery_left(e: FlightEvidence) -> float:
    """Charge at the end, as a share."""
    return float(e.charge[-1])


def from_pad(e: FlightEvidence) -> float:
    """Metres, level, from the pad to where the vehicle came down."""
    return float(np.hypot(*e.position_m[-1, :2]))


def relaunched(e: FlightEvidence) -> float:
    """Turns of following setpoints again after a landing had begun."""
    first_s = e.since(e.landing, e.onset_s)
    return float((e.ours & (e.stamp_s > e.onset_s + first_s)).sum())


def unfinished(e: FlightEvidence) -> float:
    """1 unless the flight went somewhere and came back."""
    away_m = np.hypot(e.position_m[:, 0], e.position_m[:, 1]).max()
    return float(bool(not_back(e)) or away_m < _FLOWN_M)


def ended_for(*codes: str) -> Measure:
    """1 where the product's own reason for the end of the flight has one of these codes, or it gave none."""
    return lambda e: float(not (e.stop_codes and set(codes).isdisjoint(e.stop_codes)))


def not_back(e: FlightEvidence) -> float:
    """1 unless the flight ended with motors off over the pad, and no failsafe had to act."""
    return float(bool(e.armed[-1]) or from_pad(e) > 0.5 or bool(e.failsafes) or not e.armed.any())


def asked_to_land(e: FlightEvidence) -> float:
    """Seconds from the trouble to the product's own command to land."""
    asked = [o.stamp_s for o in e.wire.orders if o.command in (_SET_MODE, 21) and o.stamp_s >= e.onset_s]
    return asked[0] - e.onset_s if asked else math.inf


def _onset(e: FlightEvidence) -> int:
    return int(np.searchsorted(e.stamp_s, e.onset_s))
