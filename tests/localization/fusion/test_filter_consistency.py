"""The filter knows how far to trust itself: NEES and NIS of 200 runs inside their chi-square bounds (Bar-Shalom, 5.4)."""

from __future__ import annotations

import numpy as np
import pytest
from filter_model_simulation import F64, error, fly
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

RUNS, SECONDS, SETTLED = 200, 2.0, 15  # poses before the unknown start is forgotten
PARTS = ("position", "velocity", "attitude", "gyro bias", "offset")
GROUPS = {name: slice(3 * k, 3 * k + 3) for k, name in enumerate(PARTS)}


def _squares(errors: F64, covariance: F64) -> float:
    return float(errors @ np.linalg.solve(covariance, errors))


@pytest.fixture(scope="module")
def runs() -> tuple[F64, F64, dict[str, F64]]:
    """NEES (RUNS,) of all 15 at the end; NIS (RUNS, poses); NEES of each group alone (RUNS,)."""
    whole, surprise, groups = np.empty(RUNS), [], {name: np.empty(RUNS) for name in GROUPS}
    for run in range(RUNS):
        fusion, truth, held = fly(run, SECONDS)
        estimate = held[-1][0]
        odom = fusion.odom_at(estimate.stamp_s)
        assert odom
        attitude = Rotation.from_quat(odom.odom_from_body.quat_wxyz, scalar_first=True)
        off = error(estimate, attitude, truth, len(held) - 1)
        whole[run] = _squares(off, estimate.covariance)
        surprise.append([nis for _, nis in held[SETTLED:]])
        for name, part in GROUPS.items():
            groups[name][run] = _squares(off[part], estimate.covariance[part, part])
    return whole, np.array(surprise), groups


def _inside(mean: float, degrees: int, count: int) -> bool:
    low, high = chi2.ppf([0.005, 0.995], degrees * count) / count
    return bool(low <= mean <= high)


def test_nees_of_the_whole_state_is_inside_its_bounds(runs: tuple[F64, F64, dict[str, F64]]) -> None:
    whole, _, _ = runs
    assert _inside(float(whole.mean()), 15, RUNS), whole.mean()


@pytest.mark.parametrize("name", GROUPS)
def test_nees_of_each_part_is_inside_its_bounds(runs: tuple[F64, F64, dict[str, F64]], name: str) -> None:
    _, _, groups = runs
    assert _inside(float(groups[name].mean()), 3, RUNS), groups[name].mean()


def test_nis_is_inside_its_bounds_at_nearly_every_pose(runs: tuple[F64, F64, dict[str, F64]]) -> None:
    """99 % bounds over the runs at each pose; and white in time: over everything the mean is inside as well."""
    _, surprise, _ = runs
    inside = [_inside(float(mean), 6, RUNS) for mean in surprise.mean(axis=0)]
    assert np.mean(inside) >= 0.9, surprise.mean(axis=0)
    assert _inside(float(surprise.mean()), 6, surprise.size), surprise.mean()
