"""Information of a view, against dense matrices, and in rooms whose answer is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.geometry import view_information as info
from uav_recon.geometry.view_information import BLIND_M, GOOD_M, MOST_M, Eye, view_sigmas
from uav_recon.types.frames import FloatArray
from uav_recon.types.localizability import SurfaceCells

EYE = Eye((math.tan(math.radians(43.5)), math.tan(math.radians(29.0))), (0.1, 0.02, -0.03))
SIZE_M = 0.2


def wall(axis: int, at_m: float, facing: float, low: tuple[float, float], high: tuple[float, float]) -> FloatArray:
    """Cells (N, 6) of a plane across an axis: place and normal."""
    others = [k for k in range(3) if k != axis]
    a, b = np.meshgrid(np.arange(low[0] + 0.1, high[0], SIZE_M), np.arange(low[1] + 0.1, high[1], SIZE_M), indexing="ij")
    cells = np.zeros((a.size, 6))
    cells[:, others[0]], cells[:, others[1]], cells[:, axis], cells[:, 3 + axis] = a.ravel(), b.ravel(), at_m, facing
    return cells


def surface(*walls: FloatArray, corners: float = 0.0) -> SurfaceCells:
    cells = np.vstack(walls)
    count = len(cells)
    return SurfaceCells(SIZE_M, cells[:, :3], cells[:, 3:], np.zeros(count), np.full(count, SIZE_M**2), np.full(count, corners))


def box_room(half_m: float = 2.5, height_m: float = 2.4) -> tuple[FloatArray, ...]:
    sides = [wall(axis, sign * half_m, -sign, (-half_m, 0.0), (half_m, height_m)) for axis in (0, 1) for sign in (-1.0, 1.0)]
    flat = [wall(2, at_m, facing, (-half_m,) * 2, (half_m,) * 2) for at_m, facing in ((0.0, 1.0), (height_m, -1.0))]
    return (*sides, *flat)


def sigma_m(cells: SurfaceCells, position: tuple[float, float, float], yaw_deg: float, pitch_deg: float = 0.0) -> float:
    angles = np.deg2rad([[yaw_deg, pitch_deg]])
    return float(view_sigmas(cells, EYE, np.array([position]), angles).sigma_m[0])


def dense_sigma_m(cells: SurfaceCells, position: FloatArray, yaw_rad: float, pitch_rad: float) -> float:
    """The same by 6 x 6 matrices of each cell, without hidden cells."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    world_from_body = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    cos, sin = math.cos(pitch_rad), math.sin(pitch_rad)
    body_from_tilted = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])  # nose down
    eye_m = position + world_from_body @ EYE.position_body_m
    arms = cells.position_world - eye_m
    x, y, z = (arms @ world_from_body @ body_from_tilted).T
    inside = (x >= 0.3) & (x <= 4.0) & (np.abs(y) < x * EYE.half_tan[0]) & (np.abs(z) < x * EYE.half_tan[1])
    some = np.flatnonzero(inside)
    followed = np.clip((cells.corners[some].sum() - info._FEW_CORNERS) / (info._MANY_CORNERS - info._FEW_CORNERS), 0.0, 1.0)
    total = np.diag([info._TURN_RAD**-2] * 3 + [0.0] * 3)
    for n in some:
        arm, normal = arms[n], cells.normal_world[n]
        far = np.linalg.norm(arm)
        if -normal @ arm / far < 0.1 and cells.spread[n] < 0.1:
            continue
        patches = cells.area_m2[n] / (x[n] * 2.0 * EYE.half_tan[0] / info._PATCHES) ** 2
        depth = patches / (info._DEPTH_M + info._DEPTH_PER_M2 * x[n] ** 2) ** 2
        spread, corners = cells.spread[n], min(cells.corners[n] * followed, patches)
        weight = info._DEPTH_SHARE * depth * ((1.0 - 3.0 * spread) * np.outer(normal, normal) + spread * np.eye(3))
        ray = np.outer(arm, arm) / far**2
        weight += corners * (np.eye(3) - ray) / (info._CORNER_RAD * x[n]) ** 2 + corners * ray * depth / patches
        skew = np.array([[0.0, -arm[2], arm[1]], [arm[2], 0.0, -arm[0]], [-arm[1], arm[0], 0.0]])
        slope = np.hstack([-skew, np.eye(3)])  # of a point that moves with the world, by its turn about the eye and its place
        total += slope.T @ weight @ slope
    place = total[3:, 3:] - total[3:, :3] @ np.linalg.solve(total[:3, :3], total[:3, 3:])
    values = np.linalg.eigvalsh(place)
    left = values[0] - max(info._WEAK_SHARE * values[2], info._WEAK_M**-2)
    return min(1.0 / math.sqrt(left), MOST_M) if left > 0.0 else MOST_M


@given(
    x=st.floats(-1.0, 1.0), y=st.floats(-1.0, 1.0), z=st.floats(0.6, 1.8), yaw=st.floats(-3.1, 3.1), pitch=st.floats(-0.2, 0.2),
    seed=st.integers(0, 99),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_it_equals_dense_matrices(x: float, y: float, z: float, yaw: float, pitch: float, seed: int) -> None:
    rng, room = np.random.default_rng(seed), surface(*box_room()[:4])
    count = len(room.area_m2)
    normal = room.normal_world + rng.normal(0.0, 0.05, (count, 3))
    room = replace(
        room,
        normal_world=normal / np.linalg.norm(normal, axis=1, keepdims=True),
        spread=np.where(rng.random(count) < 0.2, rng.uniform(0.0, 1.0 / 3.0, count), 0.0),
        corners=np.where(rng.random(count) < 0.05, rng.uniform(0.3, 3.0, count), 0.0),
    )
    position = np.array([x, y, z])
    found = view_sigmas(room, EYE, position[None], np.array([[yaw, pitch]])).sigma_m[0]
    assert found == pytest.approx(dense_sigma_m(room, position, yaw, pitch), rel=1e-6)


def test_a_bare_wall_shows_no_place_and_a_corner_of_the_room_does() -> None:
    room = surface(*box_room())
    assert sigma_m(room, (1.6, 0.0, 1.2), 0.0) == MOST_M
    assert sigma_m(room, (1.6, 1.6, 1.2), 45.0) == MOST_M, "two walls do not show the height"
    assert sigma_m(room, (1.6, 1.6, 1.2), 45.0, 40.0) < GOOD_M, "with the floor they do"


def test_painted_corners_on_a_wall_show_the_place_unless_they_are_few() -> None:
    assert sigma_m(surface(*box_room(), corners=1.0), (1.0, 0.0, 1.2), 0.0) < GOOD_M
    bare, painted = np.vstack(box_room()), surface(*box_room(), corners=0.0)
    few = np.zeros(len(bare))
    few[np.argsort(np.linalg.norm(bare[:, :3] - (2.5, 0.0, 1.2), axis=1))[:5]] = 1.0
    assert sigma_m(replace(painted, corners=few), (1.0, 0.0, 1.2), 0.0) == MOST_M


def test_what_a_wall_hides_shows_nothing() -> None:
    behind = surface(wall(0, 1.2, -1.0, (-2.5, -1.0), (2.5, 3.0)), *box_room(), corners=0.0)
    assert sigma_m(behind, (0.0, 0.0, 1.2), 0.0) == MOST_M
    open_share = view_sigmas(behind, EYE, np.array([[0.0, 0.0, 1.2]]), np.zeros((1, 2))).open_share[0]
    assert open_share == 0.0


def test_space_that_no_camera_has_seen_is_expected_to_show_something() -> None:
    none = view_sigmas(SurfaceCells.none(SIZE_M), EYE, np.zeros((2, 3)), np.zeros((2, 2)))
    assert none.sigma_m.tolist() == [MOST_M] * 2
    assert none.open_share.tolist() == [1.0] * 2
    assert (none.expected_m() < BLIND_M).all()
    bare = view_sigmas(surface(*box_room()), EYE, np.array([[1.6, 0.0, 1.2]]), np.zeros((1, 2)))
    assert bare.expected_m()[0] > BLIND_M
