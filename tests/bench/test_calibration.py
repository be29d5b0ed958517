import pytest

from uav_recon.bench.calibration import REFERENCE_EDT_S, REFERENCE_SORT_S, Calibration, calibrate


def test_the_factor_is_the_geometric_mean_of_the_two_jobs() -> None:
    assert Calibration(REFERENCE_EDT_S, REFERENCE_SORT_S).factor == pytest.approx(1.0)
    assert Calibration(4 * REFERENCE_EDT_S, REFERENCE_SORT_S).factor == pytest.approx(2.0)
    assert calibrate(runs=1).factor > 0.05
