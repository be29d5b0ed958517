"""Where the wanted nodes of a sparse lattice lie."""

from __future__ import annotations

import numpy as np

from uav_recon.mapping.neural.isosurface import ABSENT, EDGE, SparseNodes
from uav_recon.types.frames import BoolArray, FloatArray


def node_places(nodes: SparseNodes) -> tuple[FloatArray, BoolArray]:
    """World points (N, 3), and the mask that puts values back: nodes.values[mask] = f(points)."""
    mask: BoolArray = nodes.values != ABSENT
    inner = np.moveaxis(np.indices((EDGE, EDGE, EDGE)), 0, -1)
    at = nodes.blocks[:, None, None, None].astype(np.int64) * EDGE + inner
    return (nodes.origin_m.astype(np.float64) + float(nodes.voxel_m) * at)[mask], mask
