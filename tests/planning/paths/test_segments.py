from __future__ import annotations

import numpy as np

from uav_recon.planning.paths.segments import departure, length_of, segment_is_open


def test_a_line_is_blocked_by_a_single_voxel() -> None:
    mask = np.ones((5, 5, 5), dtype=np.uint8)
    assert segment_is_open(mask, 0.5, 2.5, 2.5, 4.5, 2.5, 2.5)
    mask[2, 2, 2] = 0
    assert not segment_is_open(mask, 0.5, 2.5, 2.5, 4.5, 2.5, 2.5)
    assert not segment_is_open(mask, 4.5, 2.5, 2.5, 0.5, 2.5, 2.5)
    assert segment_is_open(mask, 0.5, 0.5, 2.5, 4.5, 0.5, 2.5)


def test_length_and_departure_of_a_polyline() -> None:
    way = np.array([[0.5, 0.5, 0.5], [0.5, 0.5, 0.5], [3.5, 4.5, 0.5], [3.5, 4.5, 2.5]])
    assert length_of(way) == 7.0
    np.testing.assert_allclose(departure(way), [0.6, 0.8, 0.0])
    np.testing.assert_array_equal(departure(way[:2]), np.zeros(3))
