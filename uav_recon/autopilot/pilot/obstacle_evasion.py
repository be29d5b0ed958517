"""Giving way: what stands in the way all of a sudden stops the vehicle, and what comes on makes it step aside."""

from __future__ import annotations

import math

import numpy as np

from uav_recon.autopilot.pilot.breadcrumb_retreat import flown
from uav_recon.autopilot.pilot.sudden_obstacle import SuddenObstacle
from uav_recon.safety.envelope import Vec3
from uav_recon.safety.guard import Guard, GuardInputs
from uav_recon.types.frames import FloatArray
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Setpoint, Trajectory

IDENTIFIER = -3  # of the step aside

_FRESH_S = 0.5
_MANY_CELLS = 8  # less of it has to be seen twice, so soon after each other: one picture alone may err
_STOP_M = 1.6  # of the body's centre from what was not there: nearer, nothing is flown on
_COMING_MPS = 0.25  # nearer by so much a second
_HEED_M = 2.5  # what comes on from farther off is let come
_STEP_M, _STEP_MPS = 1.2, 0.5
_LATE_S = 0.5  # its motion is smoothed, and followed with a lag
_PASS_M = 0.4  # of the body's centre, which is a hull and an error: nearer, it leads into what comes
_ROOMS_M = ((0.20, 0.10), (0.10, 0.03), (0.0, 0.0))  # beside the hull, inside the inset: plans', ways back's, the guard's
_AFTER_S = 1.0  # after the step nothing is taken up for so long
_AHEAD_S = np.linspace(0.2, 4.0, 20)
_WAYS = 16
_AROUND = np.array([(0.0, 0.0, 0.0), *((math.cos(a), math.sin(a), 0.0) for a in np.arange(8) * math.tau / 8)])


class ObstacleEvasion:
    """One flight's. hear() once for each intruder; the rest may be asked at any time."""

    def __init__(self, guard: Guard) -> None:
        self._guard = guard
        self._heard: list[SuddenObstacle] = []

    def update(self, intruder: SuddenObstacle | None) -> None:
        """What the newest depth frame showed, None for nothing."""
        if intruder is not None and not (self._heard and self._heard[-1] is intruder):
            self._heard = [*self._heard[-3:], intruder]

    def stops(self, now_s: float) -> bool:
        """Whether something is near that was not there before, or comes on."""
        if not self._heard or not self._fresh(now_s) or not self._is_sure():
            return False
        away_m = [one.away_m for one in self._heard[-2:]]
        return away_m[-1] <= _STOP_M or (away_m[-1] <= _HEED_M and self._nearer_mps(away_m, now_s) >= _COMING_MPS)

    def why(self) -> Reason:
        """What stops it."""
        return Reason(ReasonCode.NEW_OBSTACLE, (self._heard[-1].away_m if self._heard else math.nan,))

    def step_aside(self, rest: Setpoint, situation: GuardInputs) -> Trajectory | Reason | None:
        """From rest out of the way of what comes on; None if nothing does, a reason if nowhere is known free.

        It comes on if its places come nearer to the rest: the vehicle itself still comes nearer while it stops. Where there is
        room it keeps that of planned ways; with none, a wall is better come near to than what comes on.
        """
        here = rest.position_m
        away_m = [_level_m(one.places_m[0], here) for one in self._heard[-2:]]
        coming_mps = self._nearer_mps(away_m, situation.now_s)
        if coming_mps < _COMING_MPS or away_m[-1] > _HEED_M:
            return None
        ends = _ways_aside(here, self._heard[-1].places_m, coming_mps)
        for room_m, inside_m in _ROOMS_M:
            for end in ends:
                if self._may(here, end, room_m, inside_m, situation):
                    way = np.array([here, end])
                    return flown(way, rest, situation.now_s, _STEP_MPS, situation.map_epoch, False, IDENTIFIER)
        return Reason(ReasonCode.NO_ROOM_TO_EVADE)

    def over(self, way: Trajectory, now_s: float) -> bool:
        """Whether a step aside is done."""
        return now_s - way.start_s - way.duration_s >= _AFTER_S

    def _is_sure(self) -> bool:
        last = self._heard[-1]
        again = len(self._heard) > 1 and last.stamp_s - self._heard[-2].stamp_s <= _FRESH_S
        return len(last.places_m) >= _MANY_CELLS or again

    def _fresh(self, now_s: float) -> bool:
        return now_s - self._heard[-1].stamp_s <= _FRESH_S

    def _nearer_mps(self, away_m: list[float], now_s: float) -> float:
        """How fast it comes nearer, by how far off it was at its newest two sights; 0 where there are none."""
        if len(away_m) < 2 or not self._fresh(now_s):
            return 0.0
        apart_s = self._heard[-1].stamp_s - self._heard[-2].stamp_s
        return (away_m[0] - away_m[1]) / apart_s if 0.0 < apart_s <= _FRESH_S else 0.0

    def _may(self, here: FloatArray, end: FloatArray, room_m: float, inside_m: float, situation: GuardInputs) -> bool:
        """Whether the ways to the end and to all around it are known free, and inside the fence."""
        free, envelope, a = situation.free, self._guard.envelope, _floats(here)
        return free is not None and all(
            free.admits(a, _floats(end + room_m * out)) and envelope.admits(a, _floats(end + inside_m * out)) for out in _AROUND
        )


def _level_m(a: FloatArray, b: FloatArray) -> float:
    return math.hypot(*(a - b)[:2].tolist())


def _ways_aside(here: FloatArray, places: FloatArray, coming_mps: float) -> list[FloatArray]:
    """Ends (3,) of steps, the one that keeps farthest from what comes on first; none that leads into it: a camera that has not
    yet looked round knows nothing free but where that comes from.
    """
    steps = [_STEP_M * np.array([math.cos(a), math.sin(a), 0.0]) for a in np.arange(_WAYS) * math.tau / _WAYS]
    pass_m = [_closest_m(here, here + step, places, coming_mps) for step in steps]
    ways = [n for n in range(_WAYS) if pass_m[n] >= _PASS_M or steps[n] @ (places[0] - here) <= 0.0]
    return [here + steps[n] for n in sorted(ways, key=lambda n: -pass_m[n])]


def _closest_m(here: FloatArray, end: FloatArray, places: FloatArray, coming_mps: float) -> float:
    """How near (m, level) something seen at places (N, 3), the nearest first, gets to one that goes from here to the end, if
    it comes straight on and through.
    """
    to_us = (here - places[0])[:2] / max(_level_m(here, places[0]), 1e-6)
    theirs = places[:, None, :2] + np.outer(coming_mps * _AHEAD_S, to_us)
    share = np.clip(_STEP_MPS * (_AHEAD_S - _LATE_S) / _STEP_M, 0.0, 1.0)
    ours = here[:2] + np.outer(share, (end - here)[:2])
    return float(np.linalg.norm(ours - theirs, axis=2).min())


def _floats(place: FloatArray) -> Vec3:
    x, y, z = place.tolist()
    return x, y, z
