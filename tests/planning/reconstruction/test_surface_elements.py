from __future__ import annotations

import numpy as np
from box_world import MEETING_ROOM
from uncertain_room import elements_of, seen_room

from uav_recon.planning.reconstruction.surface_elements import CELL, Elements, element_weights
from uav_recon.types.maps import SurfaceElements


def test_every_element_is_in_one_cell_with_neighbours_of_the_same_direction() -> None:
    surface, grid = elements_of(MEETING_ROOM), seen_room().grid
    elements = Elements.of(surface, grid, 5)
    assert len(elements.sigma) == -(-len(surface.uncertainty) // 5)
    assert elements.cells[0, 0] == 0
    assert elements.cells[-1, 1] == len(elements.sigma)
    np.testing.assert_array_equal(elements.cells[1:, 0], elements.cells[:-1, 1])
    cubes = set()
    for first, last, middle in elements.cells:
        cube = np.floor(elements.position[first:last] / CELL)
        assert (cube == cube[0]).all()
        axis = np.argmax(np.abs(elements.normal[first:last]), axis=1)
        assert (axis == axis[0]).all()
        cubes.add((*cube[0], axis[0], elements.normal[first, axis[0]] > 0))
        away = np.linalg.norm(elements.position[first:last] - elements.position[first:last].mean(axis=0), axis=1)
        assert away[middle - first] == away.min()
    assert len(cubes) == len(elements.cells)
    wanted = np.ravel_multi_index(tuple(np.clip(np.floor(elements.position).astype(int), 0, None).T), grid.shape)
    np.testing.assert_array_equal(elements.voxel, wanted)


def test_uncertainty_is_ranked_within_its_map() -> None:
    surface = elements_of(MEETING_ROOM)
    scaled = SurfaceElements(surface.position_world, surface.normal_world, surface.uncertainty * 1e-3, 2)
    grid = seen_room().grid
    one, other = Elements.of(surface, grid, 5), Elements.of(scaled, grid, 5)
    np.testing.assert_allclose(one.sigma, other.sigma)
    assert one.sigma.max() == 1.0
    assert 0.05 < np.mean(one.sigma == 1.0) < 0.15


def test_elements_that_are_not_finite_or_far_from_the_map_are_left_out() -> None:
    grid = seen_room().grid
    position = np.array([[1.0, 1, 0], [np.nan, 1, 0], [1, np.inf, 0], [1e300, 0, 0], [2, 1, 0], [1, 2, 0], [-3.0, 1, 0]])
    normal = np.tile([0.0, 0.0, 1.0], (7, 1))
    normal[4, 0] = np.nan
    elements = Elements.of(SurfaceElements(position, normal, np.array([1.0, 1, 1, 1, 1, np.nan, 1]), 1), grid, 1)
    assert len(elements.sigma) == 2
    assert sorted(elements.voxel)[0] == -1  # outside the grid
    empty = Elements.of(SurfaceElements(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), 1), grid, 5)
    assert len(empty.cells) == len(empty.sigma) == 0


def test_looks_reduce_the_weight() -> None:
    grid = seen_room().grid
    elements = Elements.of(elements_of(MEETING_ROOM), grid, 5)
    cosine_sums = np.zeros(grid.shape, dtype=np.float32)
    cosine_sums.ravel()[elements.voxel[elements.cells[3, 0]]] = 2.0
    weight = element_weights(elements.cells[2:5], elements.sigma, elements.voxel, cosine_sums.ravel(), 0.5)
    cosine_sum = cosine_sums.ravel()[elements.voxel] > 0
    some = np.arange(len(weight))
    asked = (some >= elements.cells[2, 0]) & (some < elements.cells[4, 1])
    np.testing.assert_array_equal(weight[~asked], 0.0)
    np.testing.assert_allclose(weight[asked & cosine_sum], elements.sigma[asked & cosine_sum] / 4)
    np.testing.assert_allclose(weight[asked & ~cosine_sum], elements.sigma[asked & ~cosine_sum])
