"""Headings at the views of a tour that turn no farther than the tasks require.

A view shows its cells from a range of headings, because the camera is wider than most clusters. A search for the best view
aims at their middle; a flight that turns to the middle of each cluster turns by about a right angle from view to view.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from uav_recon.planning.camera_frustum import CAM_X, CAM_Y, CAM_Z
from uav_recon.planning.candidate_view import CandidateView
from uav_recon.planning.frontier.camera_aiming import count_in_frustum
from uav_recon.planning.place_sight import PlaceSight
from uav_recon.types.frames import FloatArray

KEPT_SHARE = 0.9  # of the expected cells in view; the rest is mostly seen on the way to the heading
STEP_RAD = math.radians(6.0)  # between headings that are tried ...
MAX_STEPS = 7  # ... and their number on either side
MAX_CELLS = 100  # examined of those that a view promises
HEADINGS = 5  # that are compared by what they show of the place
LONG_M = 1.0  # level length of a leg that is flown nose first
OFF_RAD = math.radians(30.0)  # between nose and path on such a leg


def suited_to_path(
    views: Sequence[CandidateView],
    legs: Sequence[FloatArray],
    yaw_rad: float,
    lens: FloatArray,
    shape: tuple[int, int, int],
    sight: PlaceSight | None = None,
) -> list[CandidateView]:
    """Return the views of a tour with headings that suit the path and show the place.

    legs: (N, 3) waypoints of the leg to each view, in any unit. yaw_rad: heading at the start. lens: of the camera, see
    CameraGeometry.lens(). shape: of the map. sight: None if that does not matter.
    """
    suited = []
    for view, leg in zip(views, legs, strict=True):
        if not len(view.expected_voxels):
            yaw_rad = view.task.viewpoint.yaw_rad
            suited.append(view)
            continue
        yaw_rad = _on_arrival(leg, yaw_rad)
        low_rad, high_rad = _range(view, lens, shape)
        best_rad = view.task.viewpoint.yaw_rad
        off_rad = math.remainder(yaw_rad - best_rad, math.tau)
        yaw_rad = math.remainder(best_rad + min(max(off_rad, low_rad), high_rad), math.tau)
        if sight is not None:
            yaw_rad = sight.heading_rad(view, yaw_rad, best_rad + np.linspace(low_rad, high_rad, HEADINGS))
        suited.append(view.with_heading(yaw_rad))
    return suited


def _on_arrival(leg: FloatArray, yaw_rad: float) -> float:
    """Return the heading in which a leg (N, 3) is flown, that of its start if it is short."""
    step = leg[-1] - leg[0]
    if math.hypot(step[0], step[1]) < LONG_M:
        return yaw_rad
    off_rad = math.remainder(math.atan2(step[1], step[0]) - yaw_rad, math.tau)
    return yaw_rad + math.copysign(max(abs(off_rad) - OFF_RAD, 0.0), off_rad)


def _range(view: CandidateView, lens: FloatArray, shape: tuple[int, int, int]) -> tuple[float, float]:
    """Return the least and greatest offset from the best heading of a view.

    Between them it shows KEPT_SHARE of what it shows there.
    """
    some = view.expected_voxels[:: 1 + len(view.expected_voxels) // MAX_CELLS]
    cells: FloatArray = np.stack(np.unravel_index(some, shape), axis=1).astype(np.float64) + 0.5
    shown = _shown(view, cells, lens, 0.0)
    least = KEPT_SHARE * shown
    low = high = 0
    while high < MAX_STEPS and shown and _shown(view, cells, lens, (high + 1) * STEP_RAD) >= least:
        high += 1
    while low > -MAX_STEPS and shown and _shown(view, cells, lens, (low - 1) * STEP_RAD) >= least:
        low -= 1
    return low * STEP_RAD, high * STEP_RAD


def _shown(view: CandidateView, cells: FloatArray, lens: FloatArray, off_rad: float) -> int:
    """Return the number of cells (N, 3) in the frustum at an offset from the best heading."""
    best = view.task.viewpoint
    yaw_rad = best.yaw_rad + off_rad
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    x, y, z = lens[CAM_X], lens[CAM_Y], lens[CAM_Z]
    eye = view.position_padded - 1.0 + np.array([cos * x - sin * y, sin * x + cos * y, z])
    directions = np.ascontiguousarray((cells - eye).T, dtype=np.float32)
    return count_in_frustum(lens, directions, len(cells), yaw_rad, best.pitch_down_rad)
