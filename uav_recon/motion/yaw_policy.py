"""Where the camera looks on the way, and how fast the way may be flown on which it does not: HAZARDS, blind directions."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from uav_recon.config import Config
from uav_recon.motion.time_scaling import STEP_S
from uav_recon.types.frames import BoolArray, FloatArray

BLIND_SHARE = 0.9  # of what the guard lets pass where the camera does not look: what leads over to a new motion adds to it
SHARE = 0.85  # of a level camera's tangents: the body leans where it gains speed
SLACK = 0.05  # of speed and tangents, for what smoothing and sampling cost
GRAVITY_MPS2 = 9.81
INSIDE_RAD = 0.1  # of that, the nose is kept: the heading lags, and the way bends
SHORT_M = 0.15  # level, on a way so short it turns for its view alone
TURNS_IN_M = 0.1  # of an edge: it turns nearly on the spot
PREFERRED = 1.4  # so much longer it may take with the nose ahead: what is flown blind is refused where nobody looked lately
USUAL_SHARE = 0.6  # of the greatest speed is flown on a way, in the mean


class YawPolicy(Protocol):
    """How the heading goes along a leg, and what that means for the speed: blind_mps at most where the camera does not look."""

    @property
    def blind_mps(self) -> float:
        """It."""
        ...

    def along(self, way: FloatArray, begin: FloatArray, goal: FloatArray) -> FloatArray:
        """Vertices (M, 5) behind ``begin`` (5,) of a leg through places ``way`` (N, 3), which begin there, to ``goal`` (5,).
        The goal's yaw is the same but for whole turns.
        """
        ...

    def max_speed_mps(self, slope: FloatArray, place: FloatArray) -> FloatArray:
        """Greatest speeds (M,) at the places (M, 5) of a curve with these directions (M, 5)."""
        ...

    def max_acceleration_mps2(self, slope: FloatArray, place: FloatArray) -> FloatArray:
        """Greatest accelerations (M,) there: what leans to gain speed, or to lose it, looks elsewhere."""
        ...

    def hasty(self, rows: FloatArray) -> BoolArray:
        """Where (M - 2,), at the places (M, 5) of a motion, one each STEP_S, but its first and last, it is faster than that:
        where a body looks that leans as its acceleration asks, with a little left for what smoothing costs.
        """
        ...


class YawAtViews:
    """Evenly from view to view, and as fast wherever it looks: other limits see to it that there is room."""

    blind_mps = math.inf

    def along(self, way: FloatArray, begin: FloatArray, goal: FloatArray) -> FloatArray:
        """Each angle by its share of the length."""
        along_m = np.cumsum(np.sqrt(np.sum(np.diff(way, axis=0) ** 2, axis=1)))
        return np.hstack([way[1:], begin[3:] + (along_m / along_m[-1])[:, None] * (goal[3:] - begin[3:])])

    def max_speed_mps(self, slope: FloatArray, place: FloatArray) -> FloatArray:
        """No limit."""
        return np.full(len(place), np.inf)

    def max_acceleration_mps2(self, slope: FloatArray, place: FloatArray) -> FloatArray:
        """No limit."""
        return np.full(len(place), np.inf)

    def hasty(self, rows: FloatArray) -> BoolArray:
        """Nowhere."""
        return np.zeros(len(rows) - 2, dtype=np.bool_)


AT_VIEWS = YawAtViews()


@dataclass(frozen=True, slots=True)
class YawAlongPath:
    """Slow where the camera does not look, and on ways long enough the nose so far ahead that it does.

    half_tan: tangents of half the camera's angles, level and upright. blind_mps: greatest speed elsewhere; speed_mps and
    rate_radps: of flying and of turning, to tell what takes longer.
    """

    half_tan: tuple[float, float]
    blind_mps: float
    speed_mps: float
    rate_radps: float

    @property
    def off_rad(self) -> float:
        """So far the nose points beside the way, at most."""
        return math.atan(SHARE * self.half_tan[0]) - INSIDE_RAD

    @property
    def upright(self) -> float:
        """Tangent of half the upright angle in which a way is seen."""
        return SHARE * self.half_tan[1]

    def along(self, way: FloatArray, begin: FloatArray, goal: FloatArray) -> FloatArray:
        """As YawAtViews, or with the nose ahead if that is faster, or not much slower."""
        evenly, ahead = AT_VIEWS.along(way, begin, goal), self._ahead(way, begin, goal)
        ahead_s, evenly_s = (self._duration_s(np.vstack([begin, vertex])) for vertex in (ahead, evenly))
        return ahead if ahead_s < PREFERRED * evenly_s else evenly

    def max_speed_mps(self, slope: FloatArray, place: FloatArray) -> FloatArray:
        """blind_mps where the camera does not look."""
        return np.where(self.sees(slope[:, :3], place[:, 3], place[:, 4]), np.inf, self.blind_mps)

    def max_acceleration_mps2(self, slope: FloatArray, place: FloatArray) -> FloatArray:
        """As much as brings a way that is seen to the picture's edge. One that is not is flown slowly, and leans as it may."""
        ahead, _, below = self._in_camera(slope[:, :3], place[:, 3], place[:, 4])
        edge_rad = math.atan((1.0 - SLACK) * self.half_tan[1])
        room_rad = np.maximum(edge_rad - np.abs(np.arctan2(below, ahead)), 0.0)
        return np.where(self.sees(slope[:, :3], place[:, 3], place[:, 4]), GRAVITY_MPS2 * np.tan(room_rad), np.inf)

    def hasty(self, rows: FloatArray) -> BoolArray:
        """Held against nearly all of the picture, and a little more speed."""
        rate, place = (rows[2:, :3] - rows[:-2, :3]) / (2 * STEP_S), rows[1:-1]
        change = (rows[2:, :3] - 2 * rows[1:-1, :3] + rows[:-2, :3]) / STEP_S**2
        fast: BoolArray = np.linalg.norm(rate, axis=1) > (1.0 + SLACK) * self.blind_mps
        fast[fast] = ~self.sees(leaning(rate[fast], change[fast]), place[fast, 3], place[fast, 4], 1.0 - SLACK)
        return fast

    def sees(self, way: FloatArray, yaw_rad: FloatArray, pitch_down_rad: FloatArray, share: float = SHARE) -> BoolArray:
        """Whether the camera of a level body looks into these directions (M, 3) of the world, with a share of its tangents."""
        ahead, aside, below = self._in_camera(way, yaw_rad, pitch_down_rad)
        level, upright = share * self.half_tan[0], share * self.half_tan[1]
        return np.asarray((np.abs(aside) <= level * ahead) & (np.abs(below) <= upright * ahead))

    @staticmethod
    def _in_camera(
        way: FloatArray, yaw_rad: FloatArray, pitch_down_rad: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Along a level body's optical axis, aside and below (M,)."""
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        ahead, aside = cos * way[:, 0] + sin * way[:, 1], cos * way[:, 1] - sin * way[:, 0]
        cos, sin = np.cos(pitch_down_rad), np.sin(pitch_down_rad)
        return cos * ahead - sin * way[:, 2], aside, -sin * ahead - cos * way[:, 2]

    def _ahead(self, way: FloatArray, begin: FloatArray, goal: FloatArray) -> FloatArray:
        """The nose turns no farther than it has to, where each edge begins, and to the view where the last one ends."""
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
        """About, of a polyline (M, 5): each edge takes what its length or its turning does."""
        step, middle = np.diff(vertex, axis=0), 0.5 * (vertex[1:] + vertex[:-1])
        speed_mps = np.minimum(self.max_speed_mps(step, middle), USUAL_SHARE * self.speed_mps)
        return float(np.maximum(np.linalg.norm(step[:, :3], axis=1) / speed_mps, np.abs(step[:, 3]) / self.rate_radps).sum())


def yaw_policy_of(config: Config) -> YawPolicy:
    """At the views; nose ahead where the guard asks for slow flight out of the camera's sight."""
    safety, camera, motion = config.safety, config.camera, config.motion
    if safety.blind_speed_mps >= safety.max_speed_mps:
        return AT_VIEWS
    half_tan = (math.tan(math.radians(camera.horizontal_fov_deg) / 2), math.tan(math.radians(camera.vertical_fov_deg) / 2))
    return YawAlongPath(half_tan, BLIND_SHARE * safety.blind_speed_mps, motion.speed_mps, math.radians(motion.yaw_rate_degps))


def leaning(way: FloatArray, change_mps2: FloatArray) -> FloatArray:
    """Directions (M, 3) of the world as a body that would be level has them which leans, to gain speed by (M, 3): with its
    thrust, which carries it too, along its own upright axis (Mellinger and Kumar 2011, section III).
    """
    thrust = change_mps2 + np.array([0.0, 0.0, GRAVITY_MPS2])
    up = thrust / np.linalg.norm(thrust, axis=1, keepdims=True)
    # the smallest turn that brings up to the vertical: about their cross product
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
