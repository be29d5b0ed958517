"""Yaw along a path, and the speed limit where the camera does not look.

See docs/decisions/0004-speed-limit-outside-field-of-view.md.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from uav_recon.config import Config
from uav_recon.geometry.view_information import Eye
from uav_recon.motion.clearance import ClearanceMap
from uav_recon.motion.path_sight import PathSight
from uav_recon.motion.sight_forecast import EnteredHull, SightForecast
from uav_recon.motion.time_scaling import STEP_S
from uav_recon.safety.sight_speed_limit import SightSpeedLimit
from uav_recon.types.frames import BoolArray, FloatArray
from uav_recon.types.localizability import SurfaceCells
from uav_recon.types.recent_views import RecentViews

#: brake: planned speed outside the camera's view, of blind_speed_mps: the transition to a new motion adds to it
BLIND_SHARE = 0.9
SHARE = 0.85  # share of a level camera's tangents: the body leans where it gains speed
SLACK = 0.05  # share of speed and tangents, for the errors of smoothing and sampling
GRAVITY_MPS2 = 9.81
INSIDE_RAD = 0.1  # the nose is kept this far inside that angle: the heading lags, and the path bends
SHORT_M = 0.15  # horizontal; on a shorter edge it turns for its view only
TURNS_IN_M = 0.1  # length of an edge within which it turns: nearly on the spot
# flight where the camera does not look counts as longer by this factor: it may be refused, and shows a drift of the pose later
PREFERRED = 1.4
# ... and by this factor where the guard would refuse it
REFUSED = 10.0
USUAL_SHARE = 0.6  # mean speed on a path as a share of the greatest
# lengths of the path within which it turns at the start of an edge, and to the view at its end; pairs are compared
TURNS_M = ((TURNS_IN_M, TURNS_IN_M), (TURNS_IN_M, 0.5), (TURNS_IN_M, 1.0), (0.5, 0.5), (1.0, 1.0))
EDGE_HEADINGS = 5  # of an edge that are examined
SPARSE = 5  # rows of a motion between two whose age is examined
SAMPLE_M = 0.15  # of a path whose duration is estimated ...
SAMPLE_RAD = 0.25  # ... and of its turning
ACCELERATION_MPS2 = 0.8  # in that estimate


class YawPolicy(Protocol):
    """Rule for the heading along a leg, and the resulting speed limits.

    The limit is blind_speed_mps where the camera does not look.
    """

    @property
    def blind_speed_mps(self) -> float:
        """Speed limit where the camera does not look."""
        ...

    def forecast(
        self, views: RecentViews | None, cells: SurfaceCells | None, clearance_map: ClearanceMap, begin_s: float
    ) -> SightForecast | None:
        """Return the forecast of what the camera will have seen.

        None if the limits do not depend on it. views: of the last seconds. cells: surface by which the camera tells where it
        is, None if that does not matter. begin_s: instant at which the motion begins.
        """
        ...

    def along(
        self, leg: FloatArray, begin: FloatArray, goal: FloatArray, forecast: SightForecast | None
    ) -> tuple[FloatArray, SightForecast | None]:
        """Return the vertices (M, 5) of a leg after ``begin`` (5,), and the forecast after it.

        It ends at ``goal`` (5,), whose yaw is kept except for whole turns. leg: (N, 3) positions of the leg, from that of
        ``begin`` on.
        """
        ...

    def max_speed_mps(
        self, slope: FloatArray, place: FloatArray, forecast: SightForecast | None, reached_s: FloatArray
    ) -> FloatArray:
        """Return the speed limits (M,) at positions (M, 5) of a curve.

        slope: (M, 5) directions of the curve there. reached_s: (M,) instants at which it gets there.
        """
        ...

    def max_acceleration_mps2(self, slope: FloatArray, place: FloatArray) -> FloatArray:
        """Return the acceleration limits (M,) there.

        A body that leans to gain or lose speed looks in another direction.
        """
        ...

    def exceeds_limit(self, rows: FloatArray, forecast: SightForecast | None, begin_s: float) -> BoolArray:
        """Return a mask (M - 2,) of the rows at which a motion exceeds its speed limit.

        rows: (M, 5) positions of the motion, one each STEP_S; the first and the last are not judged. The body is taken to lean
        as its acceleration requires, and a small margin is left for the errors of smoothing. begin_s: instant of the first row.
        """
        ...


class YawAtViews:
    """Yaw changes evenly from view to view, without a speed limit.

    Other limits ensure that there is room.
    """

    blind_speed_mps = math.inf

    def forecast(
        self, views: RecentViews | None, cells: SurfaceCells | None, clearance_map: ClearanceMap, begin_s: float
    ) -> SightForecast | None:
        """Return None: nothing depends on it."""
        return None

    def along(
        self, leg: FloatArray, begin: FloatArray, goal: FloatArray, forecast: SightForecast | None
    ) -> tuple[FloatArray, SightForecast | None]:
        """Change each angle in proportion to the length."""
        return _with_even_turn(leg, begin, goal), forecast

    def max_speed_mps(
        self, slope: FloatArray, place: FloatArray, forecast: SightForecast | None, reached_s: FloatArray
    ) -> FloatArray:
        """Return infinity: no limit."""
        return np.full(len(place), np.inf)

    def max_acceleration_mps2(self, slope: FloatArray, place: FloatArray) -> FloatArray:
        """Return infinity: no limit."""
        return np.full(len(place), np.inf)

    def exceeds_limit(self, rows: FloatArray, forecast: SightForecast | None, begin_s: float) -> BoolArray:
        """Return a mask that is False everywhere."""
        return np.zeros(len(rows) - 2, dtype=np.bool_)


AT_VIEWS = YawAtViews()


@dataclass(frozen=True, slots=True)
class YawAlongPath:
    """The heading that costs least time, slow where the camera did not look lately.

    half_tan: tangents of half the camera's angles, horizontal and vertical. limit: speed limit where it does not look.
    hull: what enters the space there. speed_mps and rate_radps: limits of flying and of turning, to compare durations.
    camera_body_m: position of the camera on the body.
    """

    half_tan: tuple[float, float]
    limit: SightSpeedLimit
    hull: EnteredHull
    speed_mps: float
    rate_radps: float
    camera_body_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def blind_speed_mps(self) -> float:
        """Speed limit through space that the camera did not see lately."""
        return self.limit.blind_speed_mps

    @property
    def max_offset_rad(self) -> float:
        """Max. angle between the nose and the path."""
        return math.atan(SHARE * self.half_tan[0]) - INSIDE_RAD

    @property
    def vertical_tangent(self) -> float:
        """Tangent of half the vertical angle in which a path is seen."""
        return SHARE * self.half_tan[1]

    def forecast(
        self, views: RecentViews | None, cells: SurfaceCells | None, clearance_map: ClearanceMap, begin_s: float
    ) -> SightForecast | None:
        """Return the forecast, None if no view is known."""
        if views is None:
            return None
        sight = None if cells is None else PathSight(cells, Eye(self.half_tan, self.camera_body_m))
        return SightForecast(views, clearance_map, self.limit, self.hull, SHARE * np.array(self.half_tan), begin_s, sight=sight)

    def along(
        self, leg: FloatArray, begin: FloatArray, goal: FloatArray, forecast: SightForecast | None
    ) -> tuple[FloatArray, SightForecast | None]:
        """Return the vertices that take the least time.

        A second before a view that does not show the place counts for more.
        They turn evenly, or the nose is first and turns within one of TURNS_M, or it turns to where the view shows the place.
        """
        candidates = [_with_even_turn(leg, begin, goal), *(self._nose_first(leg, begin, goal, *turns_m) for turns_m in TURNS_M)]
        if forecast is not None and forecast.sight is not None:
            candidates += [self._nose_first(leg, begin, goal, *turns_m, forecast.sight) for turns_m in TURNS_M[:2]]
        passes = [self._estimated_pass(np.vstack([begin, vertex]), forecast) for vertex in candidates]
        # where space was not seen lately the guard may refuse a turn in flight, and the nose turns first
        fit = [n for n, one in enumerate(passes) if n <= 1 or not one.stale]
        best = min(fit, key=lambda n: passes[n].weighted_s)
        chosen = passes[best]
        return candidates[best], None if forecast is None else forecast.extended(chosen.place, chosen.reached_s)

    def max_speed_mps(
        self, slope: FloatArray, place: FloatArray, forecast: SightForecast | None, reached_s: FloatArray
    ) -> FloatArray:
        """Return the limit by age where the camera does not look, otherwise infinity."""
        blind = ~self.sees(slope[:, :3], place[:, 3], place[:, 4])
        if forecast is None:
            return np.where(blind, self.blind_speed_mps, np.inf)
        return np.maximum(forecast.max_speed_mps(slope[:, :3], place, reached_s, blind), self.blind_speed_mps)

    def max_acceleration_mps2(self, slope: FloatArray, place: FloatArray) -> FloatArray:
        """Return the acceleration that moves a seen path to the edge of the image.

        A path that is not seen is flown slowly, and has no limit.
        """
        ahead, _, below = self._in_camera(slope[:, :3], place[:, 3], place[:, 4])
        edge_rad = math.atan((1.0 - SLACK) * self.half_tan[1])
        room_rad = np.maximum(edge_rad - np.abs(np.arctan2(below, ahead)), 0.0)
        return np.where(self.sees(slope[:, :3], place[:, 3], place[:, 4]), GRAVITY_MPS2 * np.tan(room_rad), np.inf)

    def exceeds_limit(self, rows: FloatArray, forecast: SightForecast | None, begin_s: float) -> BoolArray:
        """Check against nearly the whole image, and with a small margin of speed."""
        rate, place = (rows[2:, :3] - rows[:-2, :3]) / (2 * STEP_S), rows[1:-1]
        change = (rows[2:, :3] - 2 * rows[1:-1, :3] + rows[:-2, :3]) / STEP_S**2
        speed_mps = np.linalg.norm(rate, axis=1)
        fast: BoolArray = np.asarray(speed_mps > (1.0 + SLACK) * self.blind_speed_mps)
        fast[fast] = ~self.sees(relative_to_leaning_body(rate[fast], change[fast]), place[fast, 3], place[fast, 4], 1.0 - SLACK)
        if forecast is not None and fast.any():
            reached_s = begin_s + np.arange(1, len(place) + 1, dtype=np.float64) * STEP_S
            some, asked = slice(None, None, SPARSE), np.logical_or.reduceat(fast, np.arange(0, len(fast), SPARSE))
            limit_mps = forecast.max_speed_mps(np.asarray(rate[some]), place[some], reached_s[some], asked)
            fast &= speed_mps > (1.0 + SLACK) * np.maximum(np.repeat(limit_mps, SPARSE)[: len(fast)], self.blind_speed_mps)
        return fast

    def sees(self, direction: FloatArray, yaw_rad: FloatArray, pitch_down_rad: FloatArray, share: float = SHARE) -> BoolArray:
        """Return a mask (M,) of the world directions (M, 3) that a level body's camera sees.

        share: used share of the camera's tangents.
        """
        ahead, aside, below = self._in_camera(direction, yaw_rad, pitch_down_rad)
        level, vertical = share * self.half_tan[0], share * self.half_tan[1]
        return np.asarray((np.abs(aside) <= level * ahead) & (np.abs(below) <= vertical * ahead))

    @staticmethod
    def _in_camera(
        direction: FloatArray, yaw_rad: FloatArray, pitch_down_rad: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the components (M,) along a level body's optical axis, to its side and below it."""
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        ahead, aside = cos * direction[:, 0] + sin * direction[:, 1], cos * direction[:, 1] - sin * direction[:, 0]
        cos, sin = np.cos(pitch_down_rad), np.sin(pitch_down_rad)
        return cos * ahead - sin * direction[:, 2], aside, -sin * ahead - cos * direction[:, 2]

    def _nose_first(
        self,
        leg: FloatArray,
        begin: FloatArray,
        goal: FloatArray,
        turns_m: float,
        turns_to_view_m: float,
        sight: PathSight | None = None,
    ) -> FloatArray:
        """Return the vertices with the nose first.

        At the start of each edge, within turns_m, the nose turns no farther than it has to. Where the last edge ends, within
        turns_to_view_m, it turns to the view. sight: the nose turns to where the view shows the place, while the path stays in
        view.
        """
        yaw_rad, places, yaws = float(begin[3]), [leg[0]], [float(begin[3])]
        for here, there in itertools.pairwise(leg):
            step = there - here
            if math.hypot(step[0], step[1]) >= SHORT_M:
                off = math.remainder(math.atan2(step[1], step[0]) - yaw_rad, math.tau)
                least_rad = math.copysign(max(abs(off) - self.max_offset_rad, 0.0), off)
                yaw_rad += (
                    least_rad if sight is None else self._turn_rad(here, there, np.array([yaw_rad, begin[4]]), off, sight)
                )
            places += [here + step * _share(step, turns_m), there]
            yaws += [yaw_rad, yaw_rad]
        end = places[-1] - leg[-2]
        places.insert(-1, places[-1] - end * _share(end, turns_to_view_m))
        yaws.append(yaw_rad + math.remainder(goal[3] - yaw_rad, math.tau))
        length_m = np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))
        pitch_rad = begin[4] + length_m / length_m[-1] * (goal[4] - begin[4])
        return np.column_stack([places[1:], yaws[1:], pitch_rad])

    def _estimated_pass(self, vertex: FloatArray, forecast: SightForecast | None) -> PathPass:
        """Estimate how a polyline (M, 5) is passed.

        Each piece takes the longer of its flying and its turning time, and speed changes with ACCELERATION_MPS2. The ages are
        those of a pass at the usual speed first, and then those of the pass that follows from them, which may be slower.
        """
        step = np.diff(vertex, axis=0)
        length_m = np.linalg.norm(step[:, :3], axis=1)
        pieces = np.maximum(np.ceil(np.maximum(length_m / SAMPLE_M, np.abs(step[:, 3]) / SAMPLE_RAD)), 1.0).astype(np.int64)
        edge = np.repeat(np.arange(len(pieces)), pieces)
        share = (np.arange(len(edge)) - np.repeat(np.cumsum(pieces) - pieces, pieces) + 0.5) / pieces[edge]
        place, step, piece_m = vertex[edge] + share[:, None] * step[edge], step[edge], (length_m / pieces)[edge]
        turning_s = (np.abs(step[:, 3]) / pieces[edge]) / self.rate_radps
        begin_s = 0.0 if forecast is None else forecast.end_s
        piece_s = np.maximum(piece_m / (USUAL_SHARE * self.speed_mps), turning_s)
        limit_mps = np.full(len(place), np.inf)
        for _ in range(1 if forecast is None else 2):
            limit_mps = np.minimum(limit_mps, self.max_speed_mps(step, place, forecast, begin_s + np.cumsum(piece_s)))
            piece_s = self._piece_s(limit_mps, piece_m, turning_s)
        blind = np.isfinite(limit_mps)
        weight = np.where(blind, PREFERRED, 1.0)
        if forecast is not None:
            weight[forecast.is_refused(step[:, :3], place, begin_s + np.cumsum(piece_s), blind)] = REFUSED
            if forecast.sight is not None:
                weight = weight * forecast.sight.weight(place)
        weighted_s = float(np.sum(weight * piece_s))
        return PathPass(place, begin_s + np.cumsum(piece_s), weighted_s, bool((limit_mps <= self.blind_speed_mps).any()))

    def _turn_rad(self, here: FloatArray, there: FloatArray, angles: FloatArray, off_rad: float, sight: PathSight) -> float:
        """Return the turn at the start of an edge after which its passage counts least.

        angles (2,): heading before it, and tilt of the camera. off_rad: from that heading to the direction of the edge.
        """
        turns = off_rad + np.linspace(-self.max_offset_rad, self.max_offset_rad, EDGE_HEADINGS)
        turns = np.append(turns, 0.0) if abs(off_rad) <= self.max_offset_rad else turns
        place = np.empty((len(turns), 2, 5))
        place[:, 0, :3], place[:, 1, :3] = 0.75 * here + 0.25 * there, 0.25 * here + 0.75 * there
        place[:, :, 3], place[:, :, 4] = angles[0] + turns[:, None], angles[1]
        weight = sight.weight(place.reshape(-1, 5)).reshape(-1, 2).mean(axis=1)
        flight_s = float(np.linalg.norm(there - here)) / (USUAL_SHARE * self.speed_mps)
        return float(turns[np.argmin(weight * flight_s + np.abs(turns) / self.rate_radps)])

    def _piece_s(self, limit_mps: FloatArray, piece_m: FloatArray, turning_s: FloatArray) -> FloatArray:
        """Return the time (M,) of each piece of a path.

        Speeds change with ACCELERATION_MPS2.
        """
        speed_mps = np.minimum(np.minimum(limit_mps, USUAL_SHARE * self.speed_mps), piece_m / np.maximum(turning_s, 1e-6))
        spared = 2.0 * ACCELERATION_MPS2 * np.cumsum(piece_m)
        speed2 = np.minimum.accumulate(speed_mps**2 - spared) + spared
        speed2 = np.minimum.accumulate((speed2 + spared)[::-1])[::-1] - spared
        return np.asarray(np.maximum(piece_m / np.sqrt(np.maximum(speed2, 1e-6)), turning_s))


@dataclass(frozen=True, slots=True, eq=False)
class PathPass:
    """An estimated pass along a path.

    place: (M, 5) positions. reached_s: (M,) instants at which they are reached. weighted_s: duration, in which flight where the
    camera does not look counts PREFERRED times. stale: True if a part of it leads through space not seen lately.
    """

    place: FloatArray
    reached_s: FloatArray
    weighted_s: float
    stale: bool


def yaw_policy_of(config: Config) -> YawPolicy:
    """Return YawAlongPath if the guard limits the speed outside the view, else YawAtViews."""
    safety, camera, motion = config.safety, config.camera, config.motion
    if safety.blind_speed_mps >= safety.max_speed_mps:
        return AT_VIEWS
    half_tan = (math.tan(math.radians(camera.horizontal_fov_deg) / 2), math.tan(math.radians(camera.vertical_fov_deg) / 2))
    limit = SightSpeedLimit(
        full_speed_mps=BLIND_SHARE * safety.max_speed_mps,
        blind_speed_mps=BLIND_SHARE * safety.blind_speed_mps,
        blind_fresh_s=safety.blind_fresh_s,
        blind_stale_s=safety.blind_stale_s,
        blind_memory_s=safety.blind_memory_s,
    )
    stopping_m = min(motion.speed_mps, safety.max_speed_mps) ** 2 / (2.0 * safety.max_acceleration_mps2)
    hull = EnteredHull(safety.vehicle_radius_m, stopping_m)
    at_m = camera.position_body_m
    return YawAlongPath(
        half_tan, limit, hull, motion.speed_mps, math.radians(motion.yaw_rate_degps), (at_m[0], at_m[1], at_m[2])
    )


def relative_to_leaning_body(direction: FloatArray, change_mps2: FloatArray) -> FloatArray:
    """Return world directions (M, 3) relative to a leaning body, as if the body were level.

    The body leans to accelerate by change_mps2 (M, 3): its thrust, which also carries its weight, acts along its own upright
    axis (Mellinger and Kumar 2011, section III).
    """
    thrust = change_mps2 + np.array([0.0, 0.0, GRAVITY_MPS2])
    up = thrust / np.linalg.norm(thrust, axis=1, keepdims=True)
    # the smallest rotation that brings up to the vertical: about their cross product
    x, y, z = up.T
    across = (x * direction[:, 0] + y * direction[:, 1]) / (1.0 + z)
    return np.column_stack(
        [
            direction[:, 0] - x * (direction[:, 2] + across),
            direction[:, 1] - y * (direction[:, 2] + across),
            x * direction[:, 0] + y * direction[:, 1] + z * direction[:, 2],
        ]
    )


def _share(step: FloatArray, turns_m: float) -> float:
    length_m = float(np.linalg.norm(step))
    return min(0.3 if turns_m <= TURNS_IN_M else 0.45, turns_m / length_m)


def _with_even_turn(leg: FloatArray, begin: FloatArray, goal: FloatArray) -> FloatArray:
    """Return the vertices (M, 5) of a leg with each angle changed in proportion to the length."""
    along_m = np.cumsum(np.sqrt(np.sum(np.diff(leg, axis=0) ** 2, axis=1)))
    return np.hstack([leg[1:], begin[3:] + (along_m / along_m[-1])[:, None] * (goal[3:] - begin[3:])])
