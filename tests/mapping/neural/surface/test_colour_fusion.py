"""Fusion of image colours on a field, against means over cells by hand and in numpy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike

from uav_recon.mapping.neural.keyframes.ray_buffer import RayBuffer
from uav_recon.mapping.neural.keyframes.ray_records import BEARING_UNIT, COLUMNS, DEPTH_UNIT_M
from uav_recon.mapping.neural.keyframes.ray_sampling import TOE
from uav_recon.mapping.neural.surface import colour_fusion
from uav_recon.mapping.neural.surface.colour_fusion import CELL_M, FIELD_WEIGHT_RAYS, ColourFusedField
from uav_recon.types.frames import AnyArray, Float32Array, FloatArray

LOW, HIGH = np.array([-1.0, -1.0, 0.0], dtype=np.float32), np.array([1.0, 1.0, 2.5], dtype=np.float32)
SHARP = 1e-4  # inverse depth, sigma
RED, BLUE = (200, 0, 0), (0, 0, 200)


class Plain:
    """Field with one colour everywhere."""

    def __init__(self, level: float = 0.5) -> None:
        self._level = np.float32(level)

    def distance_m(self, points: Float32Array) -> Float32Array:
        return points[:, 0].copy()

    def rgb(self, points: Float32Array) -> Float32Array:
        return np.full((len(points), 3), self._level, dtype=np.float32)


def rays(points: FloatArray, rgb: ArrayLike, coloured: int = 1) -> AnyArray:
    """Return ray records of a camera at the origin that looks along z."""
    found = np.zeros((len(points), COLUMNS), dtype=np.int16)
    found[:, :2] = np.round(points[:, :2] / points[:, 2:] / BEARING_UNIT)
    found[:, 2] = np.round(points[:, 2] / DEPTH_UNIT_M)
    found[:, 6:9], found[:, 9] = rgb, coloured
    return found


def ends(records: AnyArray) -> Float32Array:
    z = records[:, 2:3] * DEPTH_UNIT_M
    return np.concatenate([records[:, :2] * BEARING_UNIT * z, z], axis=1).astype(np.float32)


def seen(*views: AnyArray, sigma: float = SHARP) -> RayBuffer:
    replay = RayBuffer()
    for records in views:
        replay.add(records, np.eye(3), np.zeros(3), sigma, np.ones(2))
    return replay


def paint(replay: RayBuffer, level: float = 0.5) -> ColourFusedField:
    return ColourFusedField(Plain(level), replay, LOW, HIGH)


def centre(point: FloatArray) -> Float32Array:
    """Return the centre of the cell that holds a point; there the neighbours have no weight."""
    middle: Float32Array = (LOW + (np.floor((point - LOW) / CELL_M) + 0.5) * CELL_M).astype(np.float32)
    return middle


PLACE = centre(np.array([0.1, 0.2, 1.0])).astype(np.float64)


def test_a_cell_has_the_mean_colour_of_the_images_and_a_small_share_of_the_field() -> None:
    found = paint(seen(rays(PLACE[None], [RED]), rays(PLACE[None], [BLUE]))).rgb(centre(PLACE)[None])[0]
    mean = (np.array([200, 0, 200]) / 255.0 + FIELD_WEIGHT_RAYS * 0.5) / (2.0 + FIELD_WEIGHT_RAYS)
    assert found == pytest.approx(mean, abs=1e-3)


def test_a_cell_without_an_image_has_the_colour_of_the_field() -> None:
    cloudy, blind = rays(PLACE[None], [RED]), rays(PLACE[None], [RED], coloured=0)
    at = np.array([PLACE, PLACE + 0.3, [9.0, 0.0, 0.0]], dtype=np.float32)
    assert (paint(seen(blind)).rgb(at) == 0.5).all()
    assert (paint(seen(cloudy, sigma=0.05)).rgb(at) == 0.5).all()
    assert (paint(seen(cloudy)).rgb(at[1:]) == 0.5).all()
    assert (paint(seen()).rgb(at) == 0.5).all()


def test_colours_are_means_over_cells_with_linear_interpolation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(colour_fusion, "BLOCKS", 1)  # it must grow
    rng = np.random.default_rng(3)
    points = rng.uniform([-0.2, -0.2, 1.0], [0.2, 0.2, 1.1], (9000, 3))
    records = rays(points, rng.integers(0, 250, (9000, 3)))
    inside = (ends(records) - LOW) / np.float32(CELL_M) % 1.0
    records = records[((inside > 0.01) & (inside < 0.99)).all(axis=1)]  # at a cell border, rounding decides
    cell = np.floor((ends(records) - LOW) / np.float32(CELL_M)).astype(int)
    shape = (1 + cell.max() + 1,) * 3
    sums, count = np.zeros((*shape, 3)), np.zeros(shape)
    np.add.at(sums, tuple(cell.T), records[:, 6:9] / 255.0)
    np.add.at(count, tuple(cell.T), 1.0)
    asked = rng.uniform([-0.19, -0.19, 1.01], [0.19, 0.19, 1.09], (500, 3)).astype(np.float32)
    place = (asked - LOW) / CELL_M - 0.5
    low, total, weight = (
        np.floor(place).astype(int),
        np.full((500, 3), FIELD_WEIGHT_RAYS * 0.5),
        np.full(500, FIELD_WEIGHT_RAYS),
    )
    for corner in np.ndindex(2, 2, 2):
        share = np.abs(1 - np.array(corner) - (place - low)).prod(axis=1)
        at = tuple((low + corner).T)
        total += share[:, None] * sums[at]
        weight += share * count[at]
    assert paint(seen(records[:4000], records[4000:])).rgb(asked) == pytest.approx(total / weight[:, None], abs=2e-4)


def test_images_are_fused_at_the_mean_exposure() -> None:
    replay = seen(rays(PLACE[None], [(100, 100, 100)]))
    replay.views.gain[0] = 1.5
    found = paint(replay).rgb(centre(PLACE)[None])[0]
    mean = ((100 / 255.0 + TOE) * 1.5 - TOE + FIELD_WEIGHT_RAYS * 0.5) / (1.0 + FIELD_WEIGHT_RAYS)
    assert found == pytest.approx([mean] * 3, abs=1e-3)


def test_a_clipped_channel_is_a_lower_bound() -> None:
    replay = seen(rays(PLACE[None], [(255, 100, 100)]))
    replay.views.gain[0] = 0.5
    red, green, _ = paint(replay, level=0.9).rgb(centre(PLACE)[None])[0]
    assert red == pytest.approx(0.9, abs=1e-3)
    assert green < 0.4


def test_the_distance_is_that_of_the_field() -> None:
    at = np.array([[0.25, 0.0, 1.0]], dtype=np.float32)
    assert paint(seen(rays(PLACE[None], [RED]))).distance_m(at) == pytest.approx([0.25])
