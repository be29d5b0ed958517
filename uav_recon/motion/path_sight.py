"""Path sight: seconds of a path count for more where the camera does not show the place."""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.view_information import BLIND_M, GOOD_M, Eye, view_sigmas
from uav_recon.types.frames import FloatArray
from uav_recon.types.localizability import SurfaceCells

_BLIND_WEIGHT = 5.0  # of a second before a view that does not show the place, 1 before one that does
_APART = np.array([0.4, 0.4, 0.4, 0.3, 0.3])  # between positions (m) and angles (rad) that are examined


class PathSight:
    """Weights of positions in one plan. Near ones are examined once.

    cells: surface by which the camera tells where it is. eye: the camera.
    """

    def __init__(self, cells: SurfaceCells, eye: Eye) -> None:
        self._cells = cells
        self._eye = eye
        self._known: dict[tuple[int, ...], float] = {}

    def weight(self, place: FloatArray) -> FloatArray:
        """Return the weights (M,) of a second at positions (M, 5)."""
        keys = [tuple(row) for row in np.rint(place / _APART).astype(np.int64).tolist()]
        new = {key: n for n, key in enumerate(keys) if key not in self._known}
        if new:
            asked = place[list(new.values())]
            sigma_m = view_sigmas(self._cells, self._eye, asked[:, :3], asked[:, 3:]).expected_m()
            blind = (np.clip(sigma_m, GOOD_M, BLIND_M) - GOOD_M) / (BLIND_M - GOOD_M)
            self._known.update(zip(new, (1.0 + (_BLIND_WEIGHT - 1.0) * blind).tolist(), strict=True))
        return np.array([self._known[key] for key in keys])
