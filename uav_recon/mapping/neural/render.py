"""Pictures of a field: each ray is walked to the first place where the distance changes its sign."""

from __future__ import annotations

import numpy as np

from uav_recon.mapping.neural.field import Field
from uav_recon.types.frames import BoolArray, Float32Array

NEAREST_M, FARTHEST_M = 0.10, 12.0
SHORTEST_STEP_M, LONGEST_STEP_M = 0.015, 0.25
CAUTION = 0.8  # of the distance is stepped: a learned field is not exactly one
REFINEMENTS = 3


def render_rays(field: Field, origin: Float32Array, direction: Float32Array) -> tuple[Float32Array, BoolArray]:
    """Colour (N, 3) in 0..1 of the first surface on rays from origin (N, 3) along unit direction (N, 3), and which met one.

    A ray that leaves the air through nothing in FARTHEST_M has met nothing; its colour is black.
    """
    reach, found = first_surface(field, origin, direction)
    rgb = np.zeros(origin.shape, dtype=np.float32)
    rgb[found] = field.rgb(origin[found] + reach[found, None] * direction[found])
    return rgb, found


def first_surface(field: Field, origin: Float32Array, direction: Float32Array) -> tuple[Float32Array, BoolArray]:
    """Metres along each ray (N,) to where the distance first falls below zero, and whether it does (N,)."""
    count = len(origin)
    reach, found = np.full(count, FARTHEST_M, dtype=np.float32), np.zeros(count, dtype=np.bool_)
    walking, at, before = np.arange(count), np.full(count, NEAREST_M, dtype=np.float32), np.zeros(count, dtype=np.float32)
    while len(walking):
        distance = field.distance_m(origin[walking] + at[walking, None] * direction[walking])
        inside = distance < 0.0
        hit = walking[inside]
        found[hit], reach[hit] = True, at[hit]
        walking, distance = walking[~inside], distance[~inside]
        before[walking] = at[walking]
        at[walking] += np.clip(CAUTION * distance, SHORTEST_STEP_M, LONGEST_STEP_M)
        walking = walking[at[walking] < FARTHEST_M]
    met = np.flatnonzero(found)
    near, far = before[met], reach[met]
    for _ in range(REFINEMENTS):
        middle = np.float32(0.5) * (near + far)
        inside = field.distance_m(origin[met] + middle[:, None] * direction[met]) < 0.0
        near, far = np.where(inside, near, middle), np.where(inside, middle, far)
    reach[met] = np.float32(0.5) * (near + far)
    return reach, found
