"""Space between the charts of a texture is filled with the colours of their borders."""

from __future__ import annotations

import numpy as np
import pytest

from uav_recon.mapping.neural.watertight.texture_baking import spread
from uav_recon.types.frames import BoolArray, ByteArray


def _charts(height: int, width: int) -> tuple[ByteArray, BoolArray]:
    """Return an image with a red and a blue chart, far apart, and the mask of known texels."""
    picture, known = np.zeros((height, width, 3), dtype=np.uint8), np.zeros((height, width), dtype=np.bool_)
    for columns, rgb in ((slice(3, 17), (240, 20, 0)), (slice(width - 21, width - 2), (0, 20, 240))):
        picture[5 : height - 4, columns], known[5 : height - 4, columns] = rgb, True
    return picture, known


@pytest.mark.parametrize(("height", "width"), [(64, 64), (61, 87), (33, 130)])
def test_no_black_is_left_and_known_texels_are_unchanged(height: int, width: int) -> None:
    picture, known = _charts(height, width)
    before = picture.copy()
    spread(picture, known)
    np.testing.assert_array_equal(picture[known], before[known])
    assert (picture.sum(axis=2) > 150).all()
    assert (picture[:, :3, 0] > 200).all()  # beside the red chart
    assert (picture[:, -2:, 2] > 200).all()


def test_a_border_keeps_its_colour_when_scaled_down() -> None:
    picture, known = _charts(64, 64)
    spread(picture, known)
    coarse = picture.reshape(8, 8, 8, 8, 3).mean(axis=(1, 3))
    assert np.abs(coarse[4, 0] - (240, 20, 0)).max() < 25  # five of the eight columns are outside the chart


def test_an_empty_and_a_full_image_are_unchanged() -> None:
    for known in (np.zeros((5, 7), dtype=np.bool_), np.ones((5, 7), dtype=np.bool_)):
        picture = np.full((5, 7, 3), 9, dtype=np.uint8)
        spread(picture, known)
        assert (picture == 9).all()
