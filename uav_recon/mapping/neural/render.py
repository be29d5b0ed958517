"""Pictures of a field: each ray is walked to the first place where the distance changes its sign."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from uav_recon.mapping.neural.field import Field
from uav_recon.types.frames import BoolArray, Float32Array

NEAREST_M, FARTHEST_M = 0.10, 12.0
SHORTEST_STEP_M, LONGEST_STEP_M = 0.015, 0.25
CAUTION = 0.8  # of the distance is stepped: a learned field is not exactly one
REFINEMENTS = 3


Solid = Callable[[Float32Array], BoolArray]


def render_rays(field: Field, solid: Solid, origin: Float32Array, direction: Float32Array) -> tuple[Float32Array, BoolArray]:
    """Colour (N, 3) in 0..1 of the first surface on rays from origin (N, 3) along unit direction (N, 3), and which met one.

    solid(points) says where surface was measured (Evidence.holds): elsewhere a field only guesses, and is looked through.
    A ray that meets nothing in FARTHEST_M is black.
    """
    reach, found = first_surface(field, solid, origin, direction)
    rgb = np.zeros(origin.shape, dtype=np.float32)
    rgb[found] = field.rgb(origin[found] + reach[found, None] * direction[found])
    return rgb, found


def first_surface(field: Field, solid: Solid, origin: Float32Array, direction: Float32Array) -> tuple[Float32Array, BoolArray]:
    """Metres along each ray (N,) to where the distance first falls below zero on solid ground, and whether it does (N,)."""
    count = len(origin)
    reach, found = np.full(count, FARTHEST_M, dtype=np.float32), np.zeros(count, dtype=np.bool_)
    walking, at, before = np.arange(count), np.full(count, NEAREST_M, dtype=np.float32), np.zeros(count, dtype=np.float32)
    while len(walking):
        points = origin[walking] + at[walking, None] * direction[walking]
        distance = field.distance_m(points)
        inside = np.flatnonzero(distance < 0.0)
        met = inside[solid(points[inside])]
        found[walking[met]], reach[walking[met]] = True, at[walking[met]]
        left = np.ones(len(walking), dtype=np.bool_)
        left[met] = False
        walking, distance = walking[left], distance[left]
        before[walking] = at[walking]
        at[walking] += np.clip(CAUTION * distance, SHORTEST_STEP_M, LONGEST_STEP_M)
        walking = walking[at[walking] < FARTHEST_M]
    hit = np.flatnonzero(found)
    near, far = before[hit], reach[hit]
    for _ in range(REFINEMENTS):
        middle = np.float32(0.5) * (near + far)
        behind = field.distance_m(origin[hit] + middle[:, None] * direction[hit]) < 0.0
        near, far = np.where(behind, near, middle), np.where(behind, middle, far)
    reach[hit] = np.float32(0.5) * (near + far)
    return reach, found
