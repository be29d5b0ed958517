"""Obstacle evasion: stop at a sudden obstacle, and give way to an approaching one."""

from __future__ import annotations

import itertools
import math

import numpy as np

from uav_recon.autopilot.pilot.setpoints.breadcrumb_retreat import flown
from uav_recon.autopilot.pilot.situation.sudden_obstacle import SuddenObstacle
from uav_recon.safety.envelope import Vec3
from uav_recon.safety.guard import Guard, GuardInputs
from uav_recon.types.frames import FloatArray
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Setpoint, Trajectory

IDENTIFIER = -3  # identifier of the step aside

_FRESH_S = 0.5  #: evade: an obstacle that was not seen within this time no longer counts
_MANY_CELLS = 8  #: evade: with fewer cells it must be seen twice within _FRESH_S: one frame alone may be wrong
_GHOST_S = 30.0  #: evade: for this time after a ghost of the depth camera, it stops for a confirmed obstacle only
_CONFIRMING = 3  #: evade: an obstacle is confirmed, and stepped aside from, if this many frames in a row show it
_CONFIRMING_S = 0.2  #: evade: the same, for at least this time: a camera of 30 Hz shows a ghost in several frames
_KEPT = 15  #: internal: sights that are kept: half a second of a camera of 30 Hz
_STOP_M = 1.6  #: evade: stops for a sudden obstacle within this distance of the body's centre
_COMING_MPS = 0.25  #: evade: steps aside from an obstacle that approaches at least this fast; a slower one is only stopped for
_FASTEST_MPS = 2.5  #: evade: something that seems to approach faster is not one obstacle
_EVADE_M = 2.5  #: evade: an approaching obstacle farther away than this is ignored
_STEP_M = 1.2  #: evade: length of a step aside
_STEP_MPS = 0.5  #: evade: speed of a step aside
_LATE_S = 0.5  #: evade: a step takes effect after this time: its motion is smoothed, and followed with a lag
_PASS_M = 0.4  #: evade: no step that passes the obstacle closer to the body's centre: with hull and error it leads into it
_COMES_M = 0.4  #: evade: an obstacle comes if its straight path leads this near to the body's centre; others are waited for
#: internal: hull radius that _STOP_M, _PASS_M and _COMES_M are for; they grow by as much as the hull is larger
_RADIUS_M = 0.20
#: evade: clearance beside the hull, and inside the inset, tried in this order: of plans, of paths back, of the guard
_CLEARANCES_M = ((0.20, 0.10), (0.10, 0.03), (0.0, 0.0))
_AFTER_S = 1.0  #: hold: after a step aside no trajectory is flown for this time
_AHEAD_S = np.linspace(0.2, 4.0, 20)
_WAYS = 16  #: internal: number of directions of a step aside that are tried
_AROUND = np.array([(0.0, 0.0, 0.0), *((math.cos(a), math.sin(a), 0.0) for a in np.arange(8) * math.tau / 8)])


class ObstacleEvasion:
    """The evasion of one flight. Call update() once per obstacle; the other methods at any time.

    vehicle_radius_m: of the hull; distances to the body's centre follow it.
    """

    def __init__(self, guard: Guard, *, vehicle_radius_m: float) -> None:
        self._guard = guard
        self._stop_m = _STOP_M + (vehicle_radius_m - _RADIUS_M)
        self._pass_m = _PASS_M + (vehicle_radius_m - _RADIUS_M)
        self._comes_m = _COMES_M + (vehicle_radius_m - _RADIUS_M)
        self._heard: list[SuddenObstacle] = []
        self._ghost_s = -math.inf

    def update(self, intruder: SuddenObstacle | None, ghost_s: float = -math.inf) -> None:
        """Add the obstacle in the newest depth frame, None for nothing.

        ghost_s: when the camera last showed an obstacle where nothing stands.
        """
        self._ghost_s = ghost_s
        if intruder is not None and not (self._heard and self._heard[-1] is intruder):
            self._heard = [*self._heard[-_KEPT:], intruder]

    def must_stop(self, now_s: float) -> bool:
        """Return True if something near was not there before, or approaches."""
        if not self._heard or not self._fresh(now_s) or not self._is_sure(now_s):
            return False
        away_m = [one.away_m for one in self._heard[-2:]]
        return away_m[-1] <= self._stop_m or (away_m[-1] <= _EVADE_M and self._nearer_mps(away_m, now_s) >= _COMING_MPS)

    def why(self) -> Reason:
        """Return the reason why the vehicle stops."""
        return Reason(ReasonCode.NEW_OBSTACLE, (self._heard[-1].away_m if self._heard else math.nan,))

    def step_aside(self, rest: Setpoint, inputs: GuardInputs) -> Trajectory | Reason | None:
        """Return a trajectory from rest out of the path of an approaching obstacle.

        None if nothing approaches for sure, a reason if no end is known free. It approaches if its positions come nearer to the
        rest position, from each sight to the next: the vehicle itself still comes nearer while it stops; and if its straight
        path leads there: a person who crosses comes nearer, too, and is waited for. Where possible the clearance is that of
        planned paths; otherwise it is smaller: coming near a wall is better than coming near the obstacle.
        """
        here = rest.position_m
        if not self._is_confirmed() or _level_m(self._heard[-1].places_m[0], here) > _EVADE_M:
            return None
        coming_mps = self._coming_mps(here)
        if not _COMING_MPS <= coming_mps <= _FASTEST_MPS or self._passes_m(here) > self._comes_m:
            return None
        ends = _ways_aside(here, self._heard[-1].places_m, coming_mps, self._pass_m)
        for room_m, inside_m in _CLEARANCES_M:
            for end in ends:
                if self._may(here, end, room_m, inside_m, inputs):
                    way = np.array([here, end])
                    return flown(way, rest, inputs.now_s, _STEP_MPS, inputs.map_epoch, False, IDENTIFIER)
        return Reason(ReasonCode.NO_ROOM_TO_EVADE)

    def over(self, way: Trajectory, now_s: float) -> bool:
        """Return True if a step aside is done."""
        return now_s - way.start_s - way.duration_s >= _AFTER_S

    def _is_sure(self, now_s: float) -> bool:
        last = self._heard[-1]
        if now_s - self._ghost_s <= _GHOST_S:
            return self._is_confirmed()
        again = len(self._heard) > 1 and last.stamp_s - self._heard[-2].stamp_s <= _FRESH_S
        return len(last.places_m) >= _MANY_CELLS or again

    def _is_confirmed(self) -> bool:
        return self._heard[-1].sights >= _CONFIRMING and self._heard[-1].shown_s >= _CONFIRMING_S

    def _fresh(self, now_s: float) -> bool:
        return now_s - self._heard[-1].stamp_s <= _FRESH_S

    def _sights(self) -> list[SuddenObstacle]:
        """Return the newest sights in a row, oldest first."""
        newest_s = self._heard[-1].stamp_s
        return [one for one in self._heard[-self._heard[-1].sights :] if newest_s - one.stamp_s <= _FRESH_S]

    def _passes_m(self, here: FloatArray) -> float:
        """Return how near to a position the obstacle's straight path leads (m), level.

        Its track is that of the centre of what is seen of it. All that is seen moves along. The greater value of all sights
        and of their newer half counts: at the image's edge the track of what comes into view turns.
        """
        sights = self._sights()
        newer = sights[(len(sights) - 1) // 2 :]
        return max(_track_passes_m(each, here) for each in (sights, newer))

    def _coming_mps(self, here: FloatArray) -> float:
        """Return the lower of the approach speeds in the older and newer half of the newest sights.

        Infinity if one of them is no such speed.
        """
        sights = self._sights()
        ends = (sights[0], sights[len(sights) // 2], sights[-1])
        speeds = [
            (_level_m(a.places_m[0], here) - _level_m(b.places_m[0], here)) / (b.stamp_s - a.stamp_s)
            for a, b in itertools.pairwise(ends)
            if b.stamp_s > a.stamp_s
        ]
        return math.inf if not speeds or max(speeds) > _FASTEST_MPS else min(speeds)

    def _nearer_mps(self, away_m: list[float], now_s: float) -> float:
        """Return the approach speed from its newest two distances; 0 without them."""
        if len(away_m) < 2 or not self._fresh(now_s):
            return 0.0
        apart_s = self._heard[-1].stamp_s - self._heard[-2].stamp_s
        return (away_m[0] - away_m[1]) / apart_s if 0.0 < apart_s <= _FRESH_S else 0.0

    def _may(self, here: FloatArray, end: FloatArray, room_m: float, inside_m: float, inputs: GuardInputs) -> bool:
        """Return True if the paths to and around the end are known free and inside the fence."""
        free, envelope, a = inputs.free, self._guard.envelope, _floats(here)
        return free is not None and all(
            free.admits(a, _floats(end + room_m * out)) and envelope.admits(a, _floats(end + inside_m * out)) for out in _AROUND
        )


def _level_m(a: FloatArray, b: FloatArray) -> float:
    return math.hypot(*(a - b)[:2].tolist())


def _track_passes_m(sights: list[SuddenObstacle], here: FloatArray) -> float:
    """Return how near to a position (3,) the straight path through some sights leads (m), level."""
    stamp_s = np.array([one.stamp_s for one in sights])
    centre = np.array([one.places_m[:, :2].mean(axis=0) for one in sights])
    since_s = stamp_s - stamp_s.mean()
    velocity_mps = since_s @ centre / max(float(since_s @ since_s), 1e-9)
    return _nearest_m(sights[-1].places_m[:, :2] - here[:2], velocity_mps)


def _nearest_m(off_m: FloatArray, velocity_mps: FloatArray) -> float:
    """Return the least distance (m) from the origin of positions that move straight on.

    off_m (N, 2), velocity_mps (2,).
    """
    speed2 = max(float(velocity_mps @ velocity_mps), 1e-9)
    until_s = np.maximum(-(off_m @ velocity_mps) / speed2, 0.0)
    return float(np.linalg.norm(off_m + until_s[:, None] * velocity_mps, axis=1).min())


def _ways_aside(here: FloatArray, places: FloatArray, coming_mps: float, min_pass_m: float) -> list[FloatArray]:
    """Return the ends (3,) of steps, first the one that keeps farthest from the obstacle.

    No step passes the obstacle closer to the body's centre than min_pass_m: a camera that has not yet looked round knows free
    space only where the obstacle comes from.
    """
    steps = [_STEP_M * np.array([math.cos(a), math.sin(a), 0.0]) for a in np.arange(_WAYS) * math.tau / _WAYS]
    pass_m = [_closest_m(here, here + step, places, coming_mps) for step in steps]
    ways = [n for n in range(_WAYS) if pass_m[n] >= min_pass_m or steps[n] @ (places[0] - here) <= 0.0]
    return [here + steps[n] for n in sorted(ways, key=lambda n: -pass_m[n])]


def _closest_m(here: FloatArray, end: FloatArray, places: FloatArray, coming_mps: float) -> float:
    """Return the least level distance (m) of an obstacle to a vehicle that flies to ``end``.

    places: (N, 3) of the obstacle, nearest first. The obstacle is taken to come straight on and through.
    """
    to_us = (here - places[0])[:2] / max(_level_m(here, places[0]), 1e-6)
    theirs = places[:, None, :2] + np.outer(coming_mps * _AHEAD_S, to_us)
    share = np.clip(_STEP_MPS * (_AHEAD_S - _LATE_S) / _STEP_M, 0.0, 1.0)
    ours = here[:2] + np.outer(share, (end - here)[:2])
    return float(np.linalg.norm(ours - theirs, axis=2).min())


def _floats(place: FloatArray) -> Vec3:
    x, y, z = place.tolist()
    return x, y, z
