"""Where the camera looks on the way, and how fast the way may be flown on which it does not: HAZARDS, blind directions."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from uav_recon.config import Config
from uav_recon.motion.replay import STEP_S
from uav_recon.types.frames import BoolArray, FloatArray

BLIND_SHARE = 0.9  # of what the guard lets pass where the camera does not look: what leads over to a new motion adds to it
SHARE = 0.85  # of the camera's tangents: the body leans where it gains speed
SLACK = 0.05  # of speed and tangents, for what smoothing and sampling cost
INSIDE_RAD = 0.1  # of that, the nose is kept: the heading lags, and the way bends
SHORT_M = 0.15  # level, on a way so short it turns for its view alone
TURNS_IN_M = 0.1  # of an edge: it turns nearly on the spot
USUAL_SHARE = 0.6  # of the greatest speed is flown on a way, in the mean


class Gaze(Protocol):
    """How the heading goes along a leg, and what that means for the speed."""

    def along(self, way: FloatArray, begin: FloatArray, goal: FloatArray) -> FloatArray:
        """Vertices (M, 5) behind ``begin`` (5,) of a leg through places ``way`` (N, 3), which begin there, to ``goal`` (5,).
        The goal's yaw is the same but for whole turns.
        """
        ...

    def most_mps(self, slope: FloatArray, place: FloatArray) -> FloatArray:
        """Greatest speeds (M,) at the places (M, 5) of a curve with these directions (M, 5)."""
        ...

    def heeded(self, rows: FloatArray) -> bool:
        """Whether a motion through these places (M, 5), one each STEP_S, is nowhere faster, but for what smoothing costs."""
        ...


class AtViews:
    """Evenly from view to view, and as fast wherever it looks: other limits see to it that there is room."""

    def along(self, way: FloatArray, begin: FloatArray, goal: FloatArray) -> FloatArray:
        """Each angle by its share of the length."""
        along_m = np.cumsum(np.sqrt(np.sum(np.diff(way, axis=0) ** 2, axis=1)))
        return np.hstack([way[1:], begin[3:] + (along_m / along_m[-1])[:, None] * (goal[3:] - begin[3:])])

    def most_mps(self, slope: FloatArray, place: FloatArray) -> FloatArray:
        """No limit."""
        return np.full(len(place), np.inf)

    def heeded(self, rows: FloatArray) -> bool:
        """It is."""
        return True


AT_VIEWS = AtViews()


@dataclass(frozen=True, slots=True)
class NoseAhead:
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
        """As AtViews, or with the nose ahead if that is faster."""
        evenly, ahead = AT_VIEWS.along(way, begin, goal), self._ahead(way, begin, goal)
        return ahead if self._duration_s(np.vstack([begin, ahead])) < self._duration_s(np.vstack([begin, evenly])) else evenly

    def most_mps(self, slope: FloatArray, place: FloatArray) -> FloatArray:
        """blind_mps where the camera does not look."""
        return np.where(self.sees(slope[:, :3], place[:, 3], place[:, 4]), np.inf, self.blind_mps)

    def heeded(self, rows: FloatArray) -> bool:
        """Held against nearly all of the picture, and a little more speed."""
        rate, place = (rows[2:] - rows[:-2]) / (2 * STEP_S), rows[1:-1]
        fast = np.linalg.norm(rate[:, :3], axis=1) > (1.0 + SLACK) * self.blind_mps
        return bool(self.sees(rate[fast, :3], place[fast, 3], place[fast, 4], 1.0 - SLACK).all())

    def sees(self, way: FloatArray, yaw_rad: FloatArray, pitch_down_rad: FloatArray, share: float = SHARE) -> BoolArray:
        """Whether the camera of a level body looks into these directions (M, 3) of the world, with a share of its tangents."""
        cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
        ahead, aside = cos * way[:, 0] + sin * way[:, 1], cos * way[:, 1] - sin * way[:, 0]
        cos, sin = np.cos(pitch_down_rad), np.sin(pitch_down_rad)
        depth, below = cos * ahead - sin * way[:, 2], -sin * ahead - cos * way[:, 2]
        level, upright = share * self.half_tan[0], share * self.half_tan[1]
        return np.asarray((np.abs(aside) <= level * depth) & (np.abs(below) <= upright * depth))

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
        speed_mps = np.minimum(self.most_mps(step, middle), USUAL_SHARE * self.speed_mps)
        return float(np.maximum(np.linalg.norm(step[:, :3], axis=1) / speed_mps, np.abs(step[:, 3]) / self.rate_radps).sum())


def gaze_of(config: Config) -> Gaze:
    """At the views; nose ahead where the guard asks for slow flight out of the camera's sight."""
    safety, camera, motion = config.safety, config.camera, config.motion
    if safety.blind_speed_mps >= safety.max_speed_mps:
        return AT_VIEWS
    half_tan = (math.tan(math.radians(camera.horizontal_fov_deg) / 2), math.tan(math.radians(camera.vertical_fov_deg) / 2))
    return NoseAhead(half_tan, BLIND_SHARE * safety.blind_speed_mps, motion.speed_mps, math.radians(motion.yaw_rate_degps))


def _share(step: FloatArray) -> float:
    return min(0.3, TURNS_IN_M / float(np.linalg.norm(step)))
