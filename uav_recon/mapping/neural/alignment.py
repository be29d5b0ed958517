"""Pose refinement: each view is aligned to the field that all views made, without leaving what localization said of it.

Gauss-Newton on signed distances (point to implicit surface, as Newcombe et al. 2011 do with a projective one), with the
given pose as a prior. All views together must not drift: what they have in common is a motion of the whole map, which
nothing measures but the given poses, so it is taken out again.
"""

from __future__ import annotations

from itertools import compress

import numpy as np

from uav_recon.mapping.neural.field import Field
from uav_recon.mapping.neural.losses import TETRAHEDRON
from uav_recon.mapping.neural.replay import Replay
from uav_recon.types.frames import BoolArray, Float32Array, FloatArray
from uav_recon.types.pose import Pose

GIVEN_SIGMA_M, GIVEN_SIGMA_RAD = 0.012, np.deg2rad(0.35)  # of the poses that localization gives
SURFACE_SIGMA_M = 0.005  # of the field
POINTS_USED, POINTS_WORTH = 1500, 200.0  # neighbouring errors are alike: so many points say as much as ...
FEWEST = 200
ITERATIONS = 3
OUTLIER_M = 0.06
STEP_M = 0.02  # half edge of the difference stencil

_PRIOR = np.diag(1.0 / np.repeat([GIVEN_SIGMA_M, GIVEN_SIGMA_RAD], 3) ** 2)


class Alignment:
    """Corrections (V, 6) of the given poses: translation in world and rotation vector about the camera."""

    def __init__(self) -> None:
        self._rotation: list[FloatArray] = []
        self._position: list[FloatArray] = []
        self.correction: FloatArray = np.zeros((0, 6))

    def add(self, rotation: FloatArray, position: FloatArray) -> None:
        """Note the given pose world_from_depth of the next view."""
        self._rotation.append(rotation)
        self._position.append(position)
        self.correction = np.concatenate([self.correction, np.zeros((1, 6))])

    def keep(self, which: BoolArray) -> None:
        """Forget all views but some (V,)."""
        self._rotation, self._position = list(compress(self._rotation, which)), list(compress(self._position, which))
        self.correction = self.correction[which]

    def refine(self, field: Field, replay: Replay) -> None:
        """Align every view to the field and move the replayed rays there. About 10 ms a view."""
        for view in range(replay.count):
            points, sigma = replay.camera_points(view, POINTS_USED)
            self.correction[view] = self._align(view, field, points, sigma)
        self.correction -= self._common()
        for view in range(replay.count):
            rotation, position = self._pose(view, self.correction[view])
            replay.views.rotation[view], replay.views.position[view] = rotation, position

    def _align(self, view: int, field: Field, points: FloatArray, sigma_m: FloatArray) -> FloatArray:
        correction: FloatArray = self.correction[view].copy()
        for _ in range(ITERATIONS):
            rotation, position = self._pose(view, correction)
            lever = points @ rotation.T
            distance, gradient = _probe(field, (lever + position).astype(np.float32))
            slope = np.linalg.norm(gradient, axis=1)
            use = (np.abs(distance) < OUTLIER_M) & (slope > 0.5) & (slope < 1.5)
            if use.sum() < FEWEST:
                break
            jacobian = np.concatenate([gradient, np.cross(lever, gradient)], axis=1)[use]
            weight = 1.0 / (sigma_m[use] ** 2 + SURFACE_SIGMA_M**2)
            weight *= 1.0 / (1.0 + weight * distance[use] ** 2)  # Cauchy: what moved or was never learned counts little
            weight *= POINTS_WORTH / use.sum()
            normal = (jacobian * weight[:, None]).T @ jacobian + _PRIOR
            correction -= np.linalg.solve(normal, (jacobian * weight[:, None]).T @ distance[use] + _PRIOR @ correction)
        return correction

    def _pose(self, view: int, correction: FloatArray) -> tuple[FloatArray, FloatArray]:
        turn = Pose.from_rotation_vector(correction[3:], np.zeros(3)).rotation()
        rotation: FloatArray = turn @ self._rotation[view]
        return rotation, self._position[view] + correction[:3]

    def _common(self) -> FloatArray:
        """The rigid motion of the whole map that explains the corrections best, as corrections (V, 6)."""
        centre = np.stack(self._position)
        rows = np.zeros((len(centre), 6, 6))
        rows[:, :3, :3] = np.eye(3)
        rows[:, 3:, 3:] = np.eye(3)
        for column, axis in enumerate(np.eye(3)):
            rows[:, :3, 3 + column] = np.cross(axis, centre)
        normal = np.einsum("vij,ik,vkl->jl", rows, _PRIOR, rows)
        motion = np.linalg.solve(normal, np.einsum("vij,ik,vk->j", rows, _PRIOR, self.correction))
        common: FloatArray = rows @ motion
        return common


def _probe(field: Field, points: Float32Array) -> tuple[FloatArray, FloatArray]:
    """Distance (N,) and gradient (N, 3) from differences over a tetrahedron."""
    around = points[:, None] + np.float32(STEP_M) * TETRAHEDRON
    value = field.distance_m(around.reshape(-1, 3)).reshape(-1, 4).astype(np.float64)
    return value.mean(axis=1), value @ TETRAHEDRON / (4.0 * STEP_M)
