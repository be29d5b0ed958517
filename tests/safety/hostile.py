"""A million hostile proposals: `python tests/safety/hostile.py [N [SEED]]`. Prints their fates; exit 1 for a violation.

Half of them are random numbers of every size, NaN and infinities among them, before and after their time; half are small
steps from what flew last, so that they reach the checks behind the first. The space has walls, holes and a person walking.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections import Counter

import numpy as np
from rooms import BOUNDS, DT, GRID, HULL_RADIUS_M, everything, frame, guard_of, known_free, proposal, situation

from uav_recon.safety.proximity import Ahead
from uav_recon.safety.sight import Sight
from uav_recon.types.pose import Pose
from uav_recon.types.trajectory import Setpoint

AWKWARD = (math.nan, math.inf, -math.inf, 1e300, -1e9, 0.0, 4.7, 4.7000001, -0.7, 2.1, 0.2, 1.0, 2.0, 1e-300)
PLACES = 400  # proposals from each starting place


def violation(flown: Setpoint, last: Setpoint, dt_s: float, blocked: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> str:
    """What is wrong with a setpoint on the wire, by this file's own hand; '' for nothing."""
    numbers = [flown.position_m, flown.velocity_mps, flown.acceleration_mps2, [flown.yaw_rad, flown.yaw_rate_radps]]
    if not np.isfinite(np.concatenate([*numbers, [flown.camera_pitch_down_rad]])).all():
        return "not finite"
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
    if np.linalg.norm(flown.velocity_mps) > 1.0 + 1e-5 or np.linalg.norm(flown.acceleration_mps2) > 2.0 + 1e-5:
        return "too fast"
    if abs(flown.yaw_rate_radps) > 0.8 + 1e-5:
        return "turns too fast"
    if np.linalg.norm(flown.position_m - last.position_m) > 1.0 * dt_s + 0.02 + 1e-6:
        return "jumps"
    if np.linalg.norm(flown.velocity_mps - last.velocity_mps) > 2.0 * dt_s + 0.05 + 1e-6:
        return "changes speed too fast"
    turn_rad = abs(math.remainder(flown.yaw_rad - last.yaw_rad, math.tau))
    return "" if turn_rad <= 0.8 * dt_s + 0.03 + 1e-6 else "jerks round"


def attack(count: int, seed: int) -> tuple[Counter[str], list[str]]:
    """What became of each proposal, and the violations."""
    rng = np.random.default_rng(seed)
    outcomes: Counter[str] = Counter()
    violations: list[str] = []
    while outcomes.total() < count:
        free = everything() & (rng.random(GRID.shape) > 0.001)
        free[rng.integers(30, 70), :, :] &= rng.random(GRID.shape[1:]) > 0.5
        space, blocked = known_free(free), GRID.centre(np.argwhere(~free))
        start = rng.uniform([-0.5, -1.5, 0.3], [4.5, 1.5, 2.0])
        if not space.admits(tuple(start.tolist()), tuple(start.tolist())) or space._touched(
            space._in_voxels(tuple(start.tolist()))
        ):
            continue
        sight = Sight(10.0, HULL_RADIUS_M)
        guard = guard_of(bounds=dataclasses.replace(BOUNDS, blind_mps=0.3 if rng.random() < 0.5 else 1.0), sight=sight)
        now = rng.uniform(0.0, 1e5)
        here = {"free": space, "position_m": tuple(start.tolist())}
        last = guard.clear(None, situation(now, **here))[0].setpoint
        for _ in range(PLACES):
            dt_s = float(rng.choice([DT, DT, DT, 0.0, 0.01, 0.15, -0.2, 0.4]))
            now += dt_s
            ahead = Ahead(
                frame(float(rng.choice([0.2, 1.0, 9.0])), now - float(rng.choice([0.0, 0.1, 0.1, 1.0, -5.0]))), HULL_RADIUS_M
            )
            if rng.random() < 0.3:
                sight.add(frame(5.0, now), Pose.from_yaw(rng.uniform(-3, 3), last.position_m))
            if rng.random() < 0.5:
                way, push = rng.uniform(-0.02, 0.02, 3), rng.uniform(-0.06, 0.06, 3)
                p, v, a = last.position_m + last.velocity_mps * dt_s + way, last.velocity_mps + push, rng.uniform(-1, 1, 3)
                wanted = proposal(p, v, a, last.yaw_rad + rng.uniform(-0.04, 0.04), rng.uniform(-0.9, 0.9))
            else:
                p, v, a = (rng.choice([rng.normal(0, 3), rng.choice(AWKWARD)], 3) for _ in range(3))
                wanted = proposal(p, v, a, float(rng.choice(AWKWARD)), float(rng.normal()))
            age_s = float(rng.choice([0.05, 0.05, 0.05, 0.3, 3.0, math.nan, -9.0]))
            now_here = situation(now, **here, ahead=ahead, intent_age_s=age_s, pose_age_s=float(rng.choice([0.03] * 6 + [0.5])))
            flown, refusal = guard.clear(None if rng.random() < 0.05 else wanted, now_here)
            outcomes[refusal.reason.split(" at ")[0].rstrip("0123456789.-, m/s²") if refusal else "flown"] += 1
            wrong = violation(flown.setpoint, last, max(dt_s, 0.0), blocked)
            if wrong:
                violations.append(wrong)
            last = flown.setpoint
    return outcomes, violations


if __name__ == "__main__":
    number, chosen = (int(word) for word in [*sys.argv[1:], *("1000000", "1")[len(sys.argv) - 1 :]])
    fates, found = attack(number, chosen)
    print(f"{fates.total()} proposals, {fates['flown']} flown, {len(found)} violations")
    for reason, times in fates.most_common(16):
        print(f"{times:9d}  {reason}")
    sys.exit(bool(found))
