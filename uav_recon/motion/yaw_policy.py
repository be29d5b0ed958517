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
from uav_recon.motion.time_scaling import STEP_S
from uav_recon.types.frames import BoolArray, FloatArray

#: brake: planned speed outside the camera's view, of blind_speed_mps: the transition to a new motion adds to it
BLIND_SHARE = 0.9
SHARE = 0.85  # share of a level camera's tangents: the body leans where it gains speed
SLACK = 0.05  # share of speed and tangents, for the errors of smoothing and sampling
GRAVITY_MPS2 = 9.81
INSIDE_RAD = 0.1  # the nose is kept this far inside that angle: the heading lags, and the path bends
SHORT_M = 0.15  # horizontal; on a shorter edge it turns for its view only
TURNS_IN_M = 0.1  # length of an edge within which it turns: nearly on the spot
PREFERRED = 1.4  # nose first may take longer by this factor: blind flight is refused where the camera did not look lately
USUAL_SHARE = 0.6  # mean speed on a path as a share of the greatest


class YawPolicy(Protocol):
    """Rule for the heading along a leg, and the resulting speed limits.

    The limit is blind_speed_mps where the camera does not look.
    """

    @property
    def blind_speed_mps(self) -> float:
        """Speed limit where the camera does not look."""
        ...

    def along(self, way: FloatArray, begin: FloatArray, goal: FloatArray) -> FloatArray:
        """Return the vertices (M, 5) after ``begin`` (5,) of a leg to ``goal`` (5,).

        way: (N, 3) positions of the leg, from that of ``begin`` on. The goal's yaw is kept except for whole turns.
        """
        ...

    def max_speed_mps(self, slope: FloatArray, place: FloatArray) -> FloatArray:
        """Return the speed limits (M,) at positions (M, 5) of a curve.

        slope: (M, 5) directions of the curve there.
        """
        ...

    def max_acceleration_mps2(self, slope: FloatArray, place: FloatArray) -> FloatArray:
        """Return the acceleration limits (M,) there.

        A body that leans to gain or lose speed looks in another direction.
        """
        ...

    def exceeds_limit(self, rows: FloatArray) -> BoolArray:
        """Return a mask (M - 2,) of the rows at which a motion exceeds its speed limit.

        rows: (M, 5) positions of the motion, one each STEP_S; the first and the last are not judged. The body is taken to lean
        as its acceleration requires, and a small margin is left for the errors of smoothing.
        """
        ...


class YawAtViews:
    """Yaw changes evenly from view to view, without a speed limit.

    Other limits ensure that there is room.
    """

    blind_speed_mps = math.inf

    def along(self, way: FloatArray, begin: FloatArray, goal: FloatArray) -> FloatArray:
        """Change each angle in proportion to the length."""
        along_m = np.cumsum(np.sqrt(np.sum(np.diff(way, axis=0) ** 2, axis=1)))
        return np.hstack([way[1:], begin[3:] + (along_m / along_m[-1])[:, None] * (goal[3:] - begin[3:])])

    def max_speed_mps(self, slope: FloatArray, place: FloatArray) -> FloatArray:
        """Return infinity: no limit."""
        return np.full(len(place), np.inf)

    def max_acceleration_mps2(self, slope: FloatArray, place: FloatArray) -> FloatArray:
        """Return infinity: no limit."""
        return np.full(len(place), np.inf)

    def exceeds_limit(self, rows: FloatArray) -> BoolArray:
        """Return a mask that is False everywhere."""
        return np.zeros(len(rows) - 2, dtype=np.bool_)


AT_VIEWS = YawAtViews()


@dataclass(frozen=True, slots=True)
class YawAlongPath:
    """Nose first on long paths, so that the camera looks ahead; slow where it does not.

    half_tan: tangents of half the camera's angles, horizontal and vertical. blind_speed_mps: greatest speed elsewhere.
    speed_mps and rate_radps: limits of flying and of turning, to compare durations.
    """

    half_tan: tuple[float, float]
    blind_speed_mps: float
    speed_mps: float
    rate_radps: float

    @property
    def off_rad(self) -> float:
        """Max. angle between the nose and the path."""
        return math.atan(SHARE * self.half_tan[0]) - INSIDE_RAD

    @property
    def upright(self) -> float:
        """Tangent of half the vertical angle in which a path is seen."""
        return SHARE * self.half_tan[1]

    def along(self, way: FloatArray, begin: FloatArray, goal: FloatArray) -> FloatArray:
        """Return the vertices of YawAtViews, or those with the nose first if not much slower."""
        evenly, ahead = AT_VIEWS.along(way, begin, goal), self._ahead(way, begin, goal)
        ahead_s, evenly_s = (self._duration_s(np.vstack([begin, vertex])) for vertex in (ahead, evenly))
        return ahead if ahead_s < PREFERRED * evenly_s else evenly

    def max_speed_mps(self, slope: FloatArray, place: FloatArray) -> FloatArray:
        """Return blind_speed_mps where the camera does not look, otherwise infinity."""
        return np.where(self.sees(slope[:, :3], place[:, 3], place[:, 4]), np.inf, self.blind_speed_mps)

    def max_acceleration_mps2(self, slope: FloatArray, place: FloatArray) -> FloatArray:
        """Return the acceleration that moves a seen path to the edge of the image.

        A path that is not seen is flown slowly, and has no limit.
        """
        ahead, _, below = self._in_camera(slope[:, :3], place[:, 3], place[:, 4])
        edge_rad = math.atan((1.0 - SLACK) * self.half_tan[1])
        room_rad = np.maximum(edge_rad - np.abs(np.arctan2(below, ahead)), 0.0)
        return np.where(self.sees(slope[:, :3], place[:, 3], place[:, 4]), GRAVITY_MPS2 * np.tan(room_rad), np.inf)

    def exceeds_limit(self, rows: FloatArray) -> BoolArray:
        """Check against nearly the whole image, and with a small margin of speed."""
        rate, place = (rows[2:, :3] - rows[:-2, :3]) / (2 * STEP_S), rows[1:-1]
        change = (rows[2:, :3] - 2 * rows[1:-1, :3] + rows[:-2, :3]) / STEP_S**2
        fast: BoolArray = np.linalg.norm(rate, axis=1) > (1.0 + SLACK) * self.blind_speed_mps
        fast[fast] = ~self.sees(leaning(rate[fast], change[fast]), place[fast, 3], place[fast, 4], 1.0 - SLACK)
        return fast

    def sees(self, way: FloatArray, yaw_rad: FloatArray, pitch_down_rad: FloatArray, share: float = SHARE) -> BoolArray:
        """Return a mask (M,) of the world directions (M, 3) that a level body's camera sees.

        share: used share of the camera's tangents.
        """
        ahead, aside, below = self._in_camera(way, yaw_rad, pitch_down_rad)
        level, upright = share * self.half_tan[0], share * self.half_tan[1]
        return np.asarray((np.abs(aside) <= level * ahead) & (np.abs(below) <= upright * ahead))

    @staticmethod
    def _in_camera(
        way: FloatArray, yaw_rad: FloatArray, pitch_down_rad: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the components (M,) along a level body's optical axis, to its side and below it."""
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        ahead, aside = cos * way[:, 0] + sin * way[:, 1], cos * way[:, 1] - sin * way[:, 0]
        cos, sin = np.cos(pitch_down_rad), np.sin(pitch_down_rad)
        return cos * ahead - sin * way[:, 2], aside, -sin * ahead - cos * way[:, 2]

    def _ahead(self, way: FloatArray, begin: FloatArray, goal: FloatArray) -> FloatArray:
        """Return the vertices with the nose first.

        At the start of each edge the nose turns no farther than it has to. Where the last edge ends it turns to the view.
        """
        off_rad = self.off_rad
        yaw_rad, places, yaws = float(begin[3]), [way[0]], [float(begin[3])]
        for here, there in itertools.pairwise(way):
            step = there - here
            if math.hypot(step[0], step[1]) >= SHORT_M:
                off = math.remainder(math.atan2(step[1], step[0]) - yaw_rad, math.tau)
                yaw_rad += math.copysign(max(abs(off) - off_rad, 0.0), off)
            places += [here + step * _share(step), there]
            yaws += [yaw_rad, yaw_rad]
        end = places[-1] - way[-2]
        places.insert(-1, places[-1] - end * _share(end))
        yaws.append(yaw_rad + math.remainder(goal[3] - yaw_rad, math.tau))
        length_m = np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))
        pitch_rad = begin[4] + length_m / length_m[-1] * (goal[4] - begin[4])
        return np.column_stack([places[1:], yaws[1:], pitch_rad])

    def _duration_s(self, vertex: FloatArray) -> float:
        """Estimate the duration of a polyline (M, 5).

        Each edge takes the longer of its flying and its turning time.
        """
        step, middle = np.diff(vertex, axis=0), 0.5 * (vertex[1:] + vertex[:-1])
        speed_mps = np.minimum(self.max_speed_mps(step, middle), USUAL_SHARE * self.speed_mps)
        return float(np.maximum(np.linalg.norm(step[:, :3], axis=1) / speed_mps, np.abs(step[:, 3]) / self.rate_radps).sum())


def yaw_policy_of(config: Config) -> YawPolicy:
    """Return YawAlongPath if the guard limits the speed outside the view, else YawAtViews."""
    safety, camera, motion = config.safety, config.camera, config.motion
    if safety.blind_speed_mps >= safety.max_speed_mps:
        return AT_VIEWS
    half_tan = (math.tan(math.radians(camera.horizontal_fov_deg) / 2), math.tan(math.radians(camera.vertical_fov_deg) / 2))
    return YawAlongPath(half_tan, BLIND_SHARE * safety.blind_speed_mps, motion.speed_mps, math.radians(motion.yaw_rate_degps))


def leaning(way: FloatArray, change_mps2: FloatArray) -> FloatArray:
    """Return world directions (M, 3) relative to a leaning body, as if the body were level.

    The body leans to accelerate by change_mps2 (M, 3): its thrust, which also carries its weight, acts along its own upright
    axis (Mellinger and Kumar 2011, section III).
    """
    thrust = change_mps2 + np.array([0.0, 0.0, GRAVITY_MPS2])
    up = thrust / np.linalg.norm(thrust, axis=1, keepdims=True)
    # the smallest rotation that brings up to the vertical: about their cross product
    x, y, z = up.T
    across = (x * way[:, 0] + y * way[:, 1]) / (1.0 + z)
    return np.column_stack(
        [
            way[:, 0] - x * (way[:, 2] + across),
            way[:, 1] - y * (way[:, 2] + across),
            x * way[:, 0] + y * way[:, 1] + z * way[:, 2],
        ]
    )


def _share(step: FloatArray) -> float:
    return min(0.3, TURNS_IN_M / float(np.linalg.norm(step)))
