"""Plot of a calibration: distances between views, before and after."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from uav_recon.recording.plots import new_figure, save, style
from uav_recon.types.frames import FloatArray

_RANGE_MM = 60.0
_WINDOW_S = 1.0


def residuals_over_time(picture: Path, series: dict[str, tuple[FloatArray, FloatArray]]) -> None:
    """Draw the distribution of distances and their median over time.

    series: by label, the times (N,), s, and distances (N,), m, of surface patches from those of earlier views.
    """
    figure = new_figure(9.0, 3.6)
    left, right = figure.subplots(1, 2)
    style(left, "distance between views (mm)", "share of the patches", "Surfaces of two views")
    style(right, "time (s)", "median distance (mm)", "Over time")
    begin_s = min((float(stamps_s.min()) for stamps_s, _ in series.values() if len(stamps_s)), default=0.0)
    for label, (stamps_s, distance_m) in series.items():
        if not len(stamps_s):
            continue
        weights = np.full(len(distance_m), 1.0 / len(distance_m))
        left.hist(1e3 * distance_m, bins=60, range=(-_RANGE_MM, _RANGE_MM), histtype="step", weights=weights, label=label)
        second = np.floor((stamps_s - begin_s) / _WINDOW_S).astype(np.int64)
        found = np.unique(second)
        median_mm = [1e3 * float(np.median(np.abs(distance_m[second == k]))) for k in found]
        right.plot(found * _WINDOW_S, median_mm, label=label)
    left.set_ylim(top=1.3 * left.get_ylim()[1])  # room for the legend
    left.legend(frameon=False)
    right.set_ylim(bottom=0.0)
    save(figure, picture)
