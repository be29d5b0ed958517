"""A second of a path counts for more the less its view shows of the place, and near views are examined once."""

from __future__ import annotations

import numpy as np
import pytest

from uav_recon.geometry.view_information import Eye, ViewSigmas, view_sigmas
from uav_recon.motion.path_sight import PathSight
from uav_recon.types.frames import FloatArray
from uav_recon.types.localizability import SurfaceCells

EYE = Eye((0.95, 0.55), (0.1, 0.0, 0.0))


def room() -> SurfaceCells:
    """A bare wall ahead, and one with corners behind."""
    across, up = (axis.ravel() for axis in np.meshgrid(np.arange(-4.0, 4.1, 0.2), np.arange(-3.0, 3.1, 0.2)))
    ahead = np.column_stack([np.full(len(across), 2.0), across, up])
    facing = np.tile([-1.0, 0.0, 0.0], (len(across), 1))
    count = 2 * len(across)
    corners = np.repeat([0.0, 2.0], len(across))
    turned = np.array([-1.0, 1.0, 1.0])
    return SurfaceCells(
        0.2, np.vstack([ahead, ahead * turned]), np.vstack([facing, -facing]), np.zeros(count), np.full(count, 0.04), corners
    )


def test_a_second_before_a_bare_wall_counts_five_times() -> None:
    weight = PathSight(room(), EYE).weight(np.array([[0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, np.pi, 0.0]]))
    np.testing.assert_allclose(weight, [5.0, 1.0])


def test_near_views_are_examined_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def counted(cells: SurfaceCells, eye: Eye, position: FloatArray, angles: FloatArray) -> ViewSigmas:
        asked.append(len(position))
        return view_sigmas(cells, eye, position, angles)

    monkeypatch.setattr("uav_recon.motion.path_sight.view_sigmas", counted)
    sight, place = PathSight(room(), EYE), np.zeros((20, 5))
    place[:, 0] = np.linspace(0.0, 0.1, 20)
    first = sight.weight(place)
    np.testing.assert_array_equal(sight.weight(place[5:]), first[5:])
    assert asked == [1]
    sight.weight(place + np.array([0.5, 0.0, 0.0, 0.0, 0.0]))
    assert asked[0] == 1 and len(asked) == 2
