"""Texture baking: texel colours from the field, unused texels from their surroundings.

From a distance a texture is displayed scaled down, which mixes the texels between charts with the borders of the charts.
Black texels would draw a dark seam along each chart. So they are filled from coarser and coarser means of the known texels
(pull-push: Gortler et al. 1996).
"""

from __future__ import annotations

import numpy as np

from uav_recon.mapping.neural.sdf_interface import SdfField
from uav_recon.mapping.neural.watertight.texture_atlas import TextureAtlas
from uav_recon.types.frames import BoolArray, ByteArray


def baked_texture(atlas: TextureAtlas, field: SdfField) -> ByteArray:
    """Return the texture as RGB (side, side, 3)."""
    picture = np.zeros((atlas.side, atlas.side, 3), dtype=np.uint8)
    known = np.zeros((atlas.side, atlas.side), dtype=np.bool_)
    at = tuple(atlas.texels.T)
    picture[at] = np.clip(np.round(field.rgb(atlas.points) * 255.0), 0, 255)
    known[at] = True
    spread(picture, known)
    return picture


def spread(picture: ByteArray, known: BoolArray) -> None:
    """Fill the unknown pixels (H, W) of an image (H, W, 3) from the means of known neighbours.

    Changes nothing if no pixel is known.
    """
    if known.all() or not known.any():
        return
    height, width = known.shape
    halved = np.zeros((-(-height // 2), -(-width // 2), 3), dtype=np.uint16)
    count = np.zeros(halved.shape[:2], dtype=np.uint8)
    for row in (0, 1):
        for column in (0, 1):
            there = known[row::2, column::2]
            part = np.s_[: there.shape[0], : there.shape[1]]
            halved[part] += picture[row::2, column::2] * there[:, :, None]
            count[part] += there
    mean = (halved // np.maximum(count, 1)[:, :, None]).astype(np.uint8)
    spread(mean, _widened(mean, count > 0))
    for row in (0, 1):
        for column in (0, 1):
            missing = ~known[row::2, column::2]
            part = np.s_[: missing.shape[0], : missing.shape[1]]
            picture[row::2, column::2][missing] = mean[part][missing]


def _widened(picture: ByteArray, known: BoolArray) -> BoolArray:
    """Fill the ring around the known pixels (H, W) with the mean of their neighbours.

    Returns the new mask of known pixels.
    """
    height, width = known.shape
    total, count = np.zeros((height + 2, width + 2, 3), dtype=np.uint16), np.zeros((height + 2, width + 2), dtype=np.uint8)
    for row in range(3):
        for column in range(3):
            total[row : row + height, column : column + width] += picture * known[:, :, None]
            count[row : row + height, column : column + width] += known
    total, count = total[1:-1, 1:-1], count[1:-1, 1:-1]
    ring = ~known & (count > 0)
    picture[ring] = total[ring] // count[ring][:, None]
    return known | ring
