"""Centring of a band in narrow passages, where a taut path keeps to one side."""

from __future__ import annotations

import dataclasses

from uav_recon.geometry.jit import kernel
from uav_recon.motion.clearance import ClearanceMap
from uav_recon.motion.elastic_band import ElasticBand, min_clearance, mirror
from uav_recon.types.frames import AnyArray

STEP_M = 0.02
ROUNDS = 10  # moves a point by at most two voxels


def centred(band: ElasticBand, clearance_map: ClearanceMap, wanted_m: float) -> ElasticBand:
    """Return the band with its free control points moved towards more clearance.

    A point moves while its clearance is less than ``wanted_m``.
    """
    control, held = band.control.copy(), band.held.copy()
    for node in band.view_node:
        held[node : node + 3] = True  # all control points that determine where a view is passed
    _centre(control, held, clearance_map, wanted_m)
    return dataclasses.replace(band, control=control)


@kernel
def _centre(control: AnyArray, held: AnyArray, clearance_map: ClearanceMap, wanted_m: float) -> None:
    for _ in range(ROUNDS):
        moved = False
        for i in range(2, len(control) - 2):
            if held[i]:
                continue
            max_m = min_clearance(control, i, clearance_map, 0.0)
            if max_m >= wanted_m:
                continue
            axis, step_m = -1, 0.0
            for d in range(3):
                at = control[i, d]
                for side in (-STEP_M, STEP_M):
                    control[i, d] = at + side
                    mirror(control)
                    min_clearance_m = min_clearance(control, i, clearance_map, 0.0)
                    if min_clearance_m > max_m + 1e-6:
                        max_m, axis, step_m = min_clearance_m, d, side
                control[i, d] = at
            if axis >= 0:
                control[i, axis] += step_m
                moved = True
            mirror(control)
        if not moved:
            break
