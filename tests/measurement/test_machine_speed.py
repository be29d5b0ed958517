import pytest

from uav_recon.measurement.machine_speed import REFERENCE_S, Calibration, calibrate


def test_the_factor_is_the_time_here_over_the_time_on_the_reference_machine() -> None:
    same = Calibration(REFERENCE_S, REFERENCE_S)
    assert [same.factor, same.cpu_factor] == [1.0, 1.0]
    slower = Calibration(3 * REFERENCE_S, 2 * REFERENCE_S)
    assert [slower.factor, slower.cpu_factor] == pytest.approx([3.0, 2.0])


def test_cpu_time_does_not_exceed_wall_time() -> None:
    here = calibrate(runs=1)
    assert 0.05 < here.cpu_factor <= 1.05 * here.factor


def test_the_job_calls_nothing_that_numpy_dispatches_by_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    def dispatched(*_: object) -> None:
        raise AssertionError("the figure would depend on the processor's vector instructions")

    monkeypatch.setattr("numpy.sort", dispatched)
    calibrate(runs=1)
