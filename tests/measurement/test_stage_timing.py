import threading

import numpy as np

from uav_recon.measurement.stage_timing import StageTimings, Stopwatch, TimingSummary


def test_a_timing_summary_has_median_p95_and_maximum() -> None:
    spread = TimingSummary.of([1.0, 2.0, 3.0, 4.0, 100.0])
    assert (spread.median_ms, spread.max_ms) == (3.0, 100.0)
    np.testing.assert_allclose(spread.p95_ms, 80.8)
    assert spread.divided_by(2.0).median_ms == 1.5
    assert np.isnan(TimingSummary.of([]).median_ms)


def test_laps_of_a_stage_add_up_and_restart_discards_the_time_before() -> None:
    watch = Stopwatch()
    watch.lap("a")
    watch.restart()
    watch.lap("b")
    first_b = watch.ms["b"]
    watch.lap("b")
    assert watch.ms["b"] >= first_b
    assert set(watch.ms) == set(watch.cpu_ms) == {"a", "b"}


def test_waiting_is_not_cpu_time() -> None:
    watch = Stopwatch()
    threading.Event().wait(0.02)
    watch.lap("waiting")
    assert watch.ms["waiting"] >= 19.0
    assert watch.cpu_ms["waiting"] < 10.0


def test_a_frame_without_a_stage_does_not_count_for_it() -> None:
    table = StageTimings()
    for laps in ({"a": 1.0, "b": 2.0}, {"a": 3.0}):
        table.add(laps)
    np.testing.assert_allclose(table.per_frame_ms(("a", "b")), [3.0, 3.0])
    np.testing.assert_allclose(table.per_frame_ms(("b",)), [2.0])
    assert len(table) == 2
