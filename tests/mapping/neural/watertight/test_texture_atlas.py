from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from uav_recon.mapping.neural.watertight import texture_atlas
from uav_recon.mapping.neural.watertight.texture_atlas import GUTTER, TextureAtlas, unwrap
from uav_recon.types.frames import FloatArray

TEXEL_M = 0.02


def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=4, radius=0.5)


def box() -> trimesh.Trimesh:
    """Return a box of 1 x 0.6 x 0.4 m whose corners keep the normals of its sides."""
    shape = trimesh.creation.box(extents=(1.0, 0.6, 0.4))
    shape = shape.subdivide_to_size(0.1)
    shape.unmerge_vertices()
    return shape


def unwrapped(mesh: trimesh.Trimesh) -> TextureAtlas:
    return unwrap(
        np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.int64), mesh.vertex_normals.astype(np.float32), TEXEL_M
    )


def at_uv(found: TextureAtlas, uv: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return row and column of the texels that hold uv (N, 2)."""
    return np.floor((1.0 - uv[:, 1]) * found.side), np.floor(uv[:, 0] * found.side)


@pytest.mark.parametrize("shape", [ball, box])
def test_texels_have_the_position_of_their_point_on_the_face(shape: Callable[[], trimesh.Trimesh]) -> None:
    mesh = shape()
    found = unwrapped(mesh)
    random = np.random.default_rng(1)
    share = random.dirichlet(np.ones(3), len(found.faces))
    points = np.einsum("fc,fcx->fx", share, np.asarray(mesh.vertices)[found.source][found.faces])
    rows, columns = at_uv(found, np.einsum("fc,fcx->fx", share, found.uv[found.faces].astype(np.float64)))
    where = np.full((found.side, found.side, 3), np.nan)
    where[tuple(found.texels.T)] = found.points
    apart = np.linalg.norm(where[rows.astype(int), columns.astype(int)] - points, axis=1)
    assert apart.max() < 2.5 * TEXEL_M  # half a texel, and more where the face is slanted


def test_every_texel_in_use_lies_on_the_surface() -> None:
    found = unwrapped(ball())
    assert np.abs(np.linalg.norm(found.points, axis=1) - 0.5).max() < 0.01


def test_a_ball_is_six_charts_that_share_their_vertices() -> None:
    found = unwrapped(ball())
    assert len(found.source) < 1.2 * len(ball().vertices)
    np.testing.assert_array_equal(np.unique(found.source), np.arange(len(ball().vertices)))
    np.testing.assert_array_equal(np.sort(found.source[found.faces], axis=1), np.sort(np.asarray(ball().faces), axis=1))


def test_charts_are_separated_by_the_gutter() -> None:
    """Around every texel of a face, GUTTER texels belong to the same surface.

    So filtering mixes in no colour of another chart.
    """
    found = unwrapped(ball())
    used = np.zeros((found.side, found.side), dtype=bool)
    used[tuple(found.texels.T)] = True
    rows, columns = at_uv(found, found.uv.astype(np.float64))
    for down in (-1, 1):
        for across in (-1, 1):
            assert used[rows.astype(int) + down * (GUTTER - 1), columns.astype(int) + across * (GUTTER - 1)].all()


def test_an_image_that_is_too_wide_gets_larger_texels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(texture_atlas, "WIDEST", 64)
    assert unwrapped(ball()).side <= 64
