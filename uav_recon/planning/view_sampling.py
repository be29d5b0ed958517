"""Sampling of view positions on a sphere around a frontier (paper, section III-A).

All elevations from which the mount can see the frontier are sampled.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uav_recon.config import PlannerConfig
from uav_recon.planning.camera_frustum import CameraGeometry
from uav_recon.types.frames import FloatArray, IntArray

_AZIMUTHS = 16
_ELEVATIONS = 5
NEAREST_M = 0.5  # in tight rooms
FARTHEST_M = 4.2  # a fixed mount sees high and low cells only from far away
RANGE_MARGIN_M = 0.2
_STEEPEST_RAD = np.radians(80.0)
_SHELL_SHARE = 0.8  # of half the vertical angle of view: from there a target and what is around it are in the image ...
_EDGE_SHARES = (0.87, 0.94)  # ... and from there it is at the edge, with what is farther away beside it
_OFFSETS = (2048, 1024, 512)  # offsets in the shell itself, beyond it, and inside it
_PLACES = (150, 50, 30)  # max. positions of each part that are evaluated
# the generalised golden ratio of three dimensions: its powers give a sequence that fills a cube evenly for any length
_RATIO = 1.2207440846057596


def shell(camera: CameraGeometry, radii_m: tuple[float, ...], resolution_m: float) -> FloatArray:
    """Return offsets (K, 3) in voxels from a target to viewpoints.

    They form full circles at all elevations from which the mount can look at the target.
    """
    half = camera.vfov_rad / 2 * _SHELL_SHARE
    low, high = max(camera.pitch_min_rad - half, -_STEEPEST_RAD), min(camera.pitch_max_rad + half, _STEEPEST_RAD)
    return _circles(radii_m, np.linspace(low, high, _ELEVATIONS)) / resolution_m


def edge_shell(camera: CameraGeometry, radii_m: tuple[float, ...], resolution_m: float) -> FloatArray:
    """Return offsets (K, 3) from a target to positions that see it at the edge of the image.

    That is the upper or the lower edge; in voxels. A fixed mount sees a ceiling only there, from far away. None for a mount
    that is turned up and down.
    """
    if camera.pitch_max_rad > camera.pitch_min_rad:
        return np.zeros((0, 3))
    edges = [camera.pitch_min_rad + side * share * camera.vfov_rad / 2 for share in _EDGE_SHARES for side in (-1.0, 1.0)]
    return _circles(radii_m, np.clip(edges, -_STEEPEST_RAD, _STEEPEST_RAD)) / resolution_m


def _circles(radii_m: tuple[float, ...], elevations_rad: FloatArray) -> FloatArray:
    rows = [
        (radius * np.cos(elevation) * np.cos(azimuth), radius * np.cos(elevation) * np.sin(azimuth), radius * np.sin(elevation))
        for radius in radii_m
        for elevation in elevations_rad
        for azimuth in np.arange(_AZIMUTHS) * (2 * np.pi / _AZIMUTHS)
    ]
    return np.array(rows)


class ViewShell(NamedTuple):
    """Offsets of candidate view positions around a frontier, in three parts.

    The parts are the shell [d_r, d_f] itself, the space beyond it, and the space inside it.

    offsets: (K, 3) in voxels from the frontier to the positions, part after part.
    ends: (3,) end of each part in ``offsets``.
    places: (3,) number of reachable positions to evaluate in each part.
    """

    offsets: FloatArray
    ends: IntArray
    places: IntArray


def explore_shell(config: PlannerConfig, camera: CameraGeometry, resolution_m: float) -> ViewShell:
    """Return positions from which the mount brings the middle of the frontier into the image.

    The first offsets of each part are evenly spread over it: if most positions are reachable, few need to be tested.
    """
    near_m, far_m = config.shell_min_m, min(config.shell_max_m, camera.range_m - RANGE_MARGIN_M)
    spans_m = ((near_m, max(far_m, near_m)), (far_m, min(FARTHEST_M, camera.range_m - RANGE_MARGIN_M)), (NEAREST_M, near_m))
    parts = [
        _part(camera, low_m / resolution_m, high_m / resolution_m, count) if high_m > low_m else np.zeros((0, 3))
        for (low_m, high_m), count in zip(spans_m, _OFFSETS, strict=True)
    ]
    ends = np.cumsum([len(part) for part in parts])
    return ViewShell(offsets=np.concatenate(parts), ends=ends.astype(np.int64), places=np.array(_PLACES, dtype=np.int64))


def _part(camera: CameraGeometry, low: float, high: float, count: int) -> FloatArray:
    half = camera.vfov_rad / 2 * 1.1  # the view may show a part of the frontier without its middle
    lowest = np.sin(max(camera.pitch_min_rad - half, -_STEEPEST_RAD))
    highest = np.sin(min(camera.pitch_max_rad + half, _STEEPEST_RAD))
    spread = (0.5 + np.arange(1, count + 1)[:, None] / _RATIO ** np.arange(1, 4)) % 1.0
    up = lowest + (highest - lowest) * spread[:, 0]
    azimuth, radius = 2 * np.pi * spread[:, 1], low + (high - low) * spread[:, 2]
    across = np.sqrt(1.0 - up**2)
    return np.asarray(radius[:, None] * np.stack([across * np.cos(azimuth), across * np.sin(azimuth), up], axis=1))
