"""Person who walks straight across the camera's axis and is gone afterwards."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sitl.camera.d435i import DEPTH_SPEC
from sitl.faults.fault_director import AIRBORNE_M, off_nose_rad
from sitl.faults.injectors.base import Capabilities, InjectionContext, Injector
from sitl.faults.injectors.depth_camera import AHEAD_RAD, add_obstacle
from sitl.faults.injectors.obstacle import Obstacle
from sitl.faults.judges.ghost_voxels import GHOSTS, HOLES, ghost_voxels, hole_voxels
from sitl.geometry.quaternion import yaw_of

CROSSED = "person crossed"  # key in notes: seconds from the onset to the first step
LEFT = "person left"  # key in notes: seconds from the onset to the end of the walk

HALF_M = (0.25, 0.25, 0.9)  # a body 1.8 m high and 0.5 m wide
FLOOR_M = -0.1  # height of the floor in the world
NEAR_M = (0.8, 2.0)  # level distance from the body's centre to the person's near side as the person crosses the axis
WALK_MPS = (0.6, 1.5)
STOPS_S = 1.5  # a vehicle in flight that brakes as the person comes into view moves on by its speed times this time
FLYING_MPS = 0.3  # a faster vehicle flies
HOVERING_MPS = 0.1  # a slower one hovers
TURNING_RADPS = 0.15  # a faster turn may keep the person out of the image
ENTERS_MPS = 0.3  # the image's edge moves on with the vehicle; the person comes in at least this much faster
DRAWN_S = 20.0  # another walk is drawn if the scene leaves no room for this one within this time
BESIDE_M = 0.05  # from the image's edge to the person, at the beginning and at the end
OUT_RAD = math.radians(60.0)  # off the nose: outside the image, as a whole
LONGEST_S = 20.0  # from the end of the crossing: the person is gone in any case
HALF_TAN = 0.5 * DEPTH_SPEC.width / DEPTH_SPEC.fx
GONE = (0.0, 0.0, -100.0)
_KNEE_M = 0.2  # what is lower than this does not stop a person


@dataclass(frozen=True)
class Walk:
    """Straight walk at constant speed.

    start_m and way (unit): (2,) in the world, level. across_m: length from outside the image to outside the image.
    """

    start_s: float
    start_m: tuple[float, float]
    way: tuple[float, float]
    speed_mps: float
    across_m: float

    def place(self, now_s: float) -> tuple[float, float, float]:
        """Return the centre (m) of the body."""
        gone_m = self.speed_mps * max(now_s - self.start_s, 0.0)
        (x, y), (dx, dy) = self.start_m, self.way
        return x + gone_m * dx, y + gone_m * dy, FLOOR_M + HALF_M[2]

    @property
    def end_s(self) -> float:
        """Instant at which the person is outside the image on the other side."""
        return self.start_s + self.across_m / self.speed_mps


def walk_before(
    position_m: tuple[float, float, float],
    yaw_rad: float,
    stop_m: float,
    near_m: float,
    speed_mps: float,
    side: int,
    now_s: float,
) -> Walk:
    """Return the walk across the axis of a camera that looks along yaw_rad.

    stop_m: the vehicle may still move on by this; near_m: as NEAR_M, from there; side: 1 from the left, -1 from the right.
    """
    ahead, left = (math.cos(yaw_rad), math.sin(yaw_rad)), (-math.sin(yaw_rad), math.cos(yaw_rad))
    half_m = HALF_M[0] * (abs(ahead[0]) + abs(ahead[1]))  # the box is parallel to the world's axes
    away_m = stop_m + near_m + half_m
    beside_m = (away_m + half_m) * HALF_TAN + half_m + BESIDE_M
    x, y = (position_m[k] + away_m * ahead[k] + side * beside_m * left[k] for k in (0, 1))
    return Walk(now_s, (x, y), (-side * left[0], -side * left[1]), speed_mps, 2.0 * beside_m)


def is_clear(walk: Walk, surface_m: NDArray[np.float32]) -> bool:
    """Return whether no surface (N, 3) is where a camera may see the person on the walk."""
    start, way = np.array(walk.start_m), np.array(walk.way)
    off = surface_m[:, :2] - start
    along, aside = off @ way, np.abs(off @ np.array([-way[1], way[0]]))
    half_m, high = HALF_M[0] * math.sqrt(2.0), surface_m[:, 2] - FLOOR_M
    inside = (along >= half_m) & (along <= walk.across_m - half_m) & (aside <= half_m)
    return not bool((inside & (high >= _KNEE_M) & (high <= 2.0 * HALF_M[2])).any())


class PersonCrosses(Injector):
    """A person crosses once, as soon as the view is free for it.

    The person starts outside the image on one side, does not avoid the vehicle, and walks on beyond the other side. The person
    is gone as soon as the camera cannot see it there. hovering: while the vehicle hovers, else while it flies forwards.
    """

    needs = Capabilities.STAGES

    def __init__(self, hovering: bool) -> None:
        self._hovering = hovering
        self._walk: Walk | None = None
        self._left_s = math.inf
        self._obstacle: Obstacle | None = None
        self._before: NDArray[np.uint8] | None = None  # states of the map's voxels before the person came
        self._drawn, self._drawn_s = (0.0, 0.0, 1), 0.0
        self._last = (-math.inf, 0.0)  # instant and heading of the turn before

    def begin(self, at: InjectionContext) -> None:
        """Draw distance, speed and side."""
        self._draw(at)

    def _draw(self, at: InjectionContext) -> None:
        self._drawn = at.dice.uniform(*NEAR_M), at.dice.uniform(*WALK_MPS), at.dice.choice((-1, 1))

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Let the person come once it is time, and go once nobody sees it."""
        if self._walk is None:
            if since_s >= self._drawn_s + DRAWN_S:
                self._drawn_s = since_s
                self._draw(at)
            self._walk = self._next_walk(at)
            if self._walk is not None:
                at.notes[CROSSED] = since_s
                known = at.channels.voxels.latest()
                self._before = None if known is None else known.state.copy()
                self._obstacle = Obstacle(at.now_s, HALF_M, self._place)
                add_obstacle(at, self._obstacle)
        elif self._left_s == math.inf and self._is_out(at, self._walk):
            self._left_s = at.now_s
            at.notes[LEFT] = since_s

    def end(self, at: InjectionContext) -> None:
        """Count what is left of the person in the map."""
        known = at.channels.voxels.latest()
        if known is None or self._walk is None or self._obstacle is None:
            return
        until_s = min(self._left_s, at.now_s)
        stamps_s = np.arange(self._walk.start_s, until_s, 0.5 * HALF_M[0] / self._walk.speed_mps)
        places = np.array([self._walk.place(float(t)) for t in stamps_s])
        surface = at.world.clearance.bins.points
        fine = sum(ghost_voxels(one, None, places, HALF_M, surface) for one in known.fine)
        at.notes[GHOSTS] = float(ghost_voxels(known, self._before, places, HALF_M, surface) + fine)
        at.notes[HOLES] = float(hole_voxels(known, self._before, places, HALF_M, surface))

    def _place(self, now_s: float) -> tuple[float, float, float]:
        assert self._walk is not None
        return self._walk.place(now_s) if now_s < self._left_s else GONE

    def _next_walk(self, at: InjectionContext) -> Walk | None:
        """Return the walk that may begin now, None if none may."""
        truth, (near_m, walk_mps, side) = at.world.flyer.truth(), self._drawn
        speed_mps, yaw_rad, (last_s, last_rad) = math.hypot(*truth.velocity[:2]), yaw_of(truth.quat_wxyz), self._last
        turned_rad = abs(math.remainder(yaw_rad - last_rad, math.tau))
        self._last = at.now_s, yaw_rad
        if turned_rad > TURNING_RADPS * (at.now_s - last_s):
            return None
        if not truth.armed or truth.position[2] < AIRBORNE_M or "LAND" in truth.mode:
            return None
        ahead = off_nose_rad(truth.velocity, truth.quat_wxyz) <= AHEAD_RAD
        if speed_mps > HOVERING_MPS if self._hovering else not (speed_mps >= FLYING_MPS and ahead):
            return None
        if walk_mps < HALF_TAN * speed_mps + ENTERS_MPS:
            return None
        walk = walk_before(truth.position, yaw_rad, speed_mps * STOPS_S, near_m, walk_mps, side, at.now_s)
        return walk if is_clear(walk, at.world.clearance.bins.points) else None

    def _is_out(self, at: InjectionContext, walk: Walk) -> bool:
        """Return whether the person has crossed and is outside the image."""
        if at.now_s < walk.end_s:
            return False
        truth, (x, y, _) = at.world.flyer.truth(), walk.place(at.now_s)
        bearing_rad = math.atan2(y - truth.position[1], x - truth.position[0])
        off_rad = abs(math.remainder(bearing_rad - yaw_of(truth.quat_wxyz), math.tau))
        return off_rad >= OUT_RAD or at.now_s >= walk.end_s + LONGEST_S
