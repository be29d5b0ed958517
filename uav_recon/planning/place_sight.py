"""Views by what they show of the vehicle's place.

A tracker knows the vehicle's place by the surface in its view. Before a bare wall it does not know where it moves along the
wall. Such a view is no goal, and a weaker view counts for less.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uav_recon.geometry.view_information import BLIND_M, GOOD_M, view_sigmas
from uav_recon.planning.camera_frustum import CameraGeometry
from uav_recon.planning.candidate_view import CandidateView
from uav_recon.types.frames import FloatArray
from uav_recon.types.localizability import SurfaceCells


class PlaceSight:
    """Weighs views by the surface that is known.

    camera: on the body.
    """

    def __init__(self, cells: SurfaceCells, camera: CameraGeometry) -> None:
        self._cells = cells
        self._eye = camera.eye

    def weighed(self, views: Sequence[CandidateView]) -> list[CandidateView]:
        """Return the views that show the place; the gains of weak ones count for less."""
        at = np.array([one.task.viewpoint.position_world for one in views]).reshape(-1, 3)
        angles = np.array([[one.task.viewpoint.yaw_rad, one.task.viewpoint.pitch_down_rad] for one in views]).reshape(-1, 2)
        sigma_m = self._sigma_m(at, angles)
        share = np.minimum(GOOD_M / sigma_m, 1.0)
        return [
            one.with_gain(one.task.gain * weight)
            for one, weight, sigma in zip(views, share.tolist(), sigma_m.tolist(), strict=True)
            if sigma < BLIND_M
        ]

    def heading_rad(self, view: CandidateView, first_rad: float, others_rad: FloatArray) -> float:
        """Return the first heading if it shows the place well, else that which shows it best."""
        yaw_rad = np.concatenate([[first_rad], others_rad])
        at = np.tile(view.task.viewpoint.position_world, (len(yaw_rad), 1))
        angles = np.column_stack([yaw_rad, np.full(len(yaw_rad), view.task.viewpoint.pitch_down_rad)])
        return float(yaw_rad[np.argmin(np.maximum(self._sigma_m(at, angles), GOOD_M))])

    def _sigma_m(self, position_world: FloatArray, angles_rad: FloatArray) -> FloatArray:
        return view_sigmas(self._cells, self._eye, position_world, angles_rad).expected_m()
