import pytest

from uav_recon.measurement.machine_speed import REFERENCE_S, MachineSpeed, measure_machine_speed


def test_the_factor_is_the_time_here_over_the_time_on_the_reference_machine() -> None:
    same = MachineSpeed(REFERENCE_S, REFERENCE_S)
    assert [same.slowdown, same.cpu_slowdown] == [1.0, 1.0]
    slower = MachineSpeed(3 * REFERENCE_S, 2 * REFERENCE_S)
    assert [slower.slowdown, slower.cpu_slowdown] == pytest.approx([3.0, 2.0])


def test_cpu_time_does_not_exceed_wall_time() -> None:
    here = measure_machine_speed(runs=1)
    assert 0.05 < here.cpu_slowdown <= 1.05 * here.slowdown


def test_the_job_calls_nothing_that_numpy_dispatches_by_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    def dispatched(*_: object) -> None:
        raise AssertionError("the figure would depend on the processor's vector instructions")

    monkeypatch.setattr("numpy.sort", dispatched)
    measure_machine_speed(runs=1)
