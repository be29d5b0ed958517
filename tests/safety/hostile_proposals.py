"""Hostile setpoint proposals: `python tests/safety/hostile_proposals.py [N [SEED]] [--json FILE]`. Exit 1: a violation.

Half of them are random numbers of every size, NaN and infinities among them, before and after their time; half are small
steps from what flew last, so that they reach the checks behind the first. The space has walls, holes and a person walking.
"""

from __future__ import annotations

import argparse
import copy
import dataclasses
import itertools
import math
import sys
from collections import Counter, deque
from pathlib import Path

import numpy as np
from guard_rooms import BOUNDS, DT, GRID, HULL_RADIUS_M, everything, frame, guard_of, known_free, proposal, situation

from uav_recon.measurement import result_file
from uav_recon.safety.guard import GuardInputs, SetpointProposal
from uav_recon.safety.obstacle_speed_limit import ForwardDepth
from uav_recon.safety.recently_seen_space import RecentlySeenSpace
from uav_recon.types.pose import Pose
from uav_recon.types.trajectory import Setpoint

AWKWARD = (math.nan, math.inf, -math.inf, 1e300, -1e9, 0.0, 4.7, 4.7000001, -0.7, 2.1, 0.2, 1.0, 2.0, 1e-300)
PLACES = 400  # proposals from each starting place
LATELY = 12  # setpoints that are judged together
# How often a view is remembered, a proposal is wild, retreats, gives way; a degraded pose, no depth, no proposal, a new odom.
WILD = (0.3, 0.5, 0.3, 0.3, 0.1, 0.1, 0.05, 0.002)
CALM = (0.3, 0.02, 0.02, 0.02, 0.02, 0.01, 0.02, 0.001)


def violation(flown: Setpoint, last: Setpoint, dt_s: float, blocked: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> str:
    """What is wrong with a setpoint on the wire, by this file's own hand; '' for nothing."""
    numbers = [flown.position_m, flown.velocity_mps, flown.acceleration_mps2, [flown.yaw_rad, flown.yaw_rate_radps]]
    if not np.isfinite(np.concatenate([*numbers, [flown.camera_pitch_down_rad]])).all():
        return "not finite"
    return misplaced(flown, blocked) or too_fast(flown) or unsteady(flown, last, dt_s)


def misplaced(flown: Setpoint, blocked: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> str:
    """What is wrong with where a setpoint is and where it would stop; '' for nothing."""
    stop = flown.position_m + flown.velocity_mps * np.linalg.norm(flown.velocity_mps) / 4.0
    for place in (flown.position_m, stop):
        floor_m = -0.2 if np.hypot(*place[:2]) <= 0.5 + 1e-6 else 0.2
        if not (
            np.all(place >= [-0.7 - 1e-6, -1.7 - 1e-6, floor_m - 1e-6]) and np.all(place <= np.array([4.7, 1.7, 2.1]) + 1e-6)
        ):
            return f"outside the fence at {place}"
        level = np.hypot(*(blocked[:, :2] - place[:2]).T)
        if np.any((level <= HULL_RADIUS_M - 1e-6) & (np.abs(blocked[:, 2] - place[2]) <= 0.1 - 1e-6)):
            return f"in what is not known free at {place}"
    return ""


def too_fast(flown: Setpoint) -> str:
    """What is wrong with a setpoint's motion; '' for nothing."""
    if np.linalg.norm(flown.velocity_mps) > 1.0 + 1e-5 or np.linalg.norm(flown.acceleration_mps2) > 2.0 + 1e-5:
        return "too fast"
    return "turns too fast" if abs(flown.yaw_rate_radps) > 0.8 + 1e-5 else ""


def unsteady(flown: Setpoint, last: Setpoint, dt_s: float) -> str:
    """What is wrong with the step from the setpoint before; '' for nothing."""
    if np.linalg.norm(flown.position_m - last.position_m) > 1.0 * dt_s + 0.02 + 1e-6:
        return "jumps"
    if np.linalg.norm(flown.velocity_mps - last.velocity_mps) > 2.0 * dt_s + 0.05 + 1e-6:
        return "changes speed too fast"
    turn_rad = abs(math.remainder(flown.yaw_rad - last.yaw_rad, math.tau))
    return "" if turn_rad <= 0.8 * dt_s + 0.03 + 1e-6 else "jerks round"


def adds_up(flown: deque[tuple[float, Setpoint]]) -> str:
    """What is wrong with setpoints, each with the seconds since the one before, taken together; '' for nothing. A slack is one
    slack, however many they are, and a place lies where the velocities have led.
    """
    since_s = allowed_m = turned_rad = 0.0
    led_m, (_, newest) = np.zeros(3), flown[-1]
    for (_, before), (dt_s, after) in itertools.pairwise(list(flown)):
        since_s, allowed_m = since_s + dt_s, allowed_m + 2.0 * dt_s**2 / 4.0
        led_m = led_m + (before.velocity_mps + after.velocity_mps) / 2.0 * dt_s
        turned_rad += math.remainder(after.yaw_rad - before.yaw_rad, math.tau)
    oldest = flown[0][1]
    way_m = newest.position_m - oldest.position_m
    if np.linalg.norm(way_m) > 1.0 * since_s + 0.02 + 1e-6:
        return "jumps in many steps"
    if np.linalg.norm(newest.velocity_mps - oldest.velocity_mps) > 2.0 * since_s + 0.05 + 1e-6:
        return "changes speed too fast in many steps"
    if abs(turned_rad) > 0.8 * since_s + 0.03 + 1e-6:
        return "jerks round in many steps"
    return "moves without a velocity" if np.linalg.norm(way_m - led_m) > 0.04 + allowed_m + 1e-6 else ""


def undue(wanted: SetpointProposal, here: GuardInputs, range_m: float) -> str:
    """What is wrong with a proposal that was flown as it was asked, by what was known; '' for nothing. range_m: of a frame
    that shows the same wall in every cell.
    """
    velocity = wanted.setpoint.velocity_mps
    speed, forward = float(np.linalg.norm(velocity)), float(velocity[0])
    most = 0.5 if wanted.evading else 0.3 if wanted.retreating or here.slow else 1.0
    if speed > most + 1e-5:
        return "faster than is due"
    if not (-0.1 <= here.pose_age_s <= 0.2 and (wanted.retreating or -0.1 <= here.intent_age_s <= 0.5)):
        return "on an old word"
    if speed <= 0.02 or (here.ahead is None and wanted.retreating):
        return ""
    age_s = math.inf if here.ahead is None else here.now_s - here.ahead.stamp_s
    if not wanted.retreating and not -0.1 - 1e-6 <= age_s <= 0.3 + 1e-6:
        return "blind"
    way_m = speed * (0.25 + min(max(age_s, 0.0), 0.3)) + speed**2 / 4.0
    return "into a wall" if forward > 0.99 * speed and way_m > range_m - 0.1 + 1e-6 else ""


def wild(rng: np.random.Generator) -> SetpointProposal:
    """Random numbers of every size."""
    p, v, a = (rng.choice([rng.normal(0, 3), rng.choice(AWKWARD)], 3) for _ in range(3))
    return proposal(p, v, a, float(rng.choice(AWKWARD)), float(rng.normal()))


def near(
    rng: np.random.Generator, last: Setpoint, dt_s: float, goal_mps: np.ndarray[tuple[int], np.dtype[np.float64]] | None
) -> SetpointProposal:
    """A small step from the last setpoint, with a random push, or one towards a velocity."""
    way = rng.uniform(-0.01, 0.01, 3)
    push = rng.uniform(-0.06, 0.06, 3) if goal_mps is None else np.clip(goal_mps - last.velocity_mps, -0.03, 0.03)
    p, v, a = last.position_m + last.velocity_mps * dt_s + way, last.velocity_mps + push, rng.uniform(-1, 1, 3)
    return proposal(p, v, a, last.yaw_rad + rng.uniform(-0.04, 0.04), rng.uniform(-0.9, 0.9))


def attack(count: int, seed: int) -> tuple[Counter[str], list[str]]:
    """What became of each proposal, and the violations."""
    rng = np.random.default_rng(seed)
    outcomes: Counter[str] = Counter()
    violations: list[str] = []
    views = {range_m: ForwardDepth(frame(range_m), HULL_RADIUS_M) for range_m in (0.2, 1.0, 2.0, 9.0)}
    while outcomes.total() < count:
        free = everything() & (rng.random(GRID.shape) > 0.001)
        free[rng.integers(30, 70), :, :] &= rng.random(GRID.shape[1:]) > 0.5
        space, blocked = known_free(free), GRID.centre(np.argwhere(~free))
        start = rng.uniform([-0.5, -1.5, 0.3], [4.5, 1.5, 2.0])
        place = (float(start[0]), float(start[1]), float(start[2]))
        if any(space._touched(space._in_voxels(place), space._in_voxels(place))):
            continue
        sight = RecentlySeenSpace(blind_memory_s=10.0, vehicle_radius_m=HULL_RADIUS_M)
        guard = guard_of(bounds=dataclasses.replace(BOUNDS, blind_speed_mps=0.3 if rng.random() < 0.5 else 1.0), sight=sight)
        now = rng.uniform(0.0, 1e5)
        usual = situation(now, free=space, position_m=place)
        last = guard.clear(None, usual)[0].setpoint
        lately = deque([(0.0, last)], maxlen=LATELY)
        goal, calm = rng.uniform(-0.8, 0.8, 3), int(20 * rng.integers(0, 2))  # calm: faults are rare, so that it gets fast
        drawn = zip(
            *(
                rng.choice(usually * (1 + calm) + seldom, PLACES).tolist()
                for usually, seldom in (
                    ([DT, DT, DT], [0.0, 0.01, 0.15, -0.2, 0.4]),
                    ([9.0], [0.2, 1.0, 2.0]),
                    ([0.0, 0.1, 0.1], [0.25, 1.0, -5.0]),
                    ([0.05, 0.05, 0.05], [0.3, 3.0, math.nan, -9.0]),
                    ([0.03, 0.03, 0.03], [0.5]),
                )
            ),
            (rng.random((PLACES, 8)) < (CALM if calm else WILD)).tolist(),
            strict=True,
        )
        for dt_s, range_m, frame_age_s, intent_age_s, pose_age_s, chances in drawn:
            looks, far, retreating, evading, slow, unseen, silent, jumped = chances
            now += dt_s
            ahead = copy.copy(views[range_m])
            ahead.stamp_s = now - frame_age_s
            if looks:
                sight.add(frame(5.0, now), Pose.from_yaw(rng.uniform(-3, 3), last.position_m))
            wanted = wild(rng) if far else near(rng, last, dt_s, goal if calm else None)
            wanted = dataclasses.replace(wanted, retreating=retreating, evading=evading)
            here = dataclasses.replace(
                usual, now_s=now, ahead=None if unseen else ahead, intent_age_s=intent_age_s, pose_age_s=pose_age_s, slow=slow
            )
            if jumped:
                lately.clear()
                guard.rebase(here, rest_s=0.0)
                here = dataclasses.replace(here, position_m=tuple(last.position_m.tolist()), yaw_rad=last.yaw_rad)
            asked = None if silent else wanted
            cleared, refusal = guard.clear(asked, here)
            flown = cleared.setpoint
            outcomes[refusal.reason.code.value if refusal else "flown" if asked else "braked"] += 1
            wrong = violation(flown, last, math.inf if jumped else max(dt_s, 0.0), blocked)
            lately.append((max(dt_s, 0.0), flown))
            wrong = wrong or adds_up(lately) or (undue(wanted, here, range_m) if flown is wanted.setpoint else "")
            if wrong:
                violations.append(wrong)
            last = flown
    return outcomes, violations


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("count", type=int, nargs="?", default=1_000_000)
    parser.add_argument("seed", type=int, nargs="?", default=1)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    fates, found = attack(options.count, options.seed)
    print(f"{fates.total()} proposals, {fates['flown']} flown, {len(found)} violations")
    for reason, times in fates.most_common(16):
        print(f"{times:9d}  {reason}")
    if options.json:
        result_file.save(options.json, {"proposals": fates.total(), "violations": len(found), "outcomes": dict(fates)})
    sys.exit(bool(found))
