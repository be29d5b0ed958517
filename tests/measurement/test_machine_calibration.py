import pytest

from uav_recon.measurement.machine_calibration import REFERENCE_EDT_S, REFERENCE_SORT_S, Calibration, calibrate


def test_the_factor_is_the_geometric_mean_of_the_two_jobs() -> None:
    edt_s, sort_s = REFERENCE_EDT_S, REFERENCE_SORT_S
    same = Calibration(edt_s, sort_s, edt_s, sort_s)
    assert [same.factor, same.cpu_factor] == pytest.approx([1.0, 1.0])
    slower = Calibration(4 * edt_s, sort_s, 9 * edt_s, sort_s)
    assert [slower.factor, slower.cpu_factor] == pytest.approx([2.0, 3.0])


def test_cpu_time_does_not_exceed_wall_time() -> None:
    here = calibrate(runs=1)
    assert 0.05 < here.cpu_factor <= 1.05 * here.factor
