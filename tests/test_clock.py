from __future__ import annotations

import subprocess
import sys
import threading
import time
from concurrent.futures import CancelledError

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uav_recon.clock import DetachedExecutor, InlineExecutor, ManualClock, MonotonicClock, RateKeeper, ThreadExecutor

rates = st.floats(1.0, 400.0)
starts = st.floats(0.0, 1e6)


@given(rates, starts, st.lists(st.floats(0.0, 0.2), min_size=1, max_size=60))
def test_a_job_runs_at_most_once_per_period_and_missed_ones_are_skipped(
    rate_hz: float, start_s: float, gaps_s: list[float]
) -> None:
    keeper = RateKeeper(rate_hz, start_s)
    now_s, done = start_s, []
    for gap_s in gaps_s:
        now_s += gap_s
        if keeper.due(now_s):
            done.append(now_s)
            assert not keeper.due(now_s)
    periods = int((now_s - start_s) * rate_hz + 1e-6) + 1
    assert len(done) <= periods
    cells = [int((t - start_s) * rate_hz + 1e-6) for t in done]
    assert cells == sorted(set(cells))


@given(st.integers(1, 200), starts)
def test_a_rate_keeper_does_not_drift(rate_hz: int, start_s: float) -> None:
    keeper = RateKeeper(float(rate_hz), start_s)
    done = sum(keeper.due(start_s + k / (4 * rate_hz)) for k in range(4 * rate_hz))
    assert done == rate_hz
    assert keeper.next_s() == pytest.approx(start_s + 1.0)


@given(rates, starts, st.floats(0.0, 10.0))
def test_the_next_time_is_in_the_future_and_is_when_the_job_is_due(rate_hz: float, start_s: float, late_s: float) -> None:
    keeper = RateKeeper(rate_hz, start_s)
    assert keeper.due(start_s + late_s)
    assert start_s + late_s - 1e-5 < keeper.next_s() <= start_s + late_s + 1.0 / rate_hz + 1e-6
    assert not keeper.due(keeper.next_s() - 0.01 / rate_hz)
    assert keeper.due(keeper.next_s())


def test_a_manual_clock_moves_only_forward_and_only_by_its_owner() -> None:
    clock = ManualClock(5.0)
    clock.sleep_until(9.0)
    assert clock.now_s() == 5.0
    clock.advance_to(5.0)
    clock.advance_to(6.0)
    with pytest.raises(ValueError, match="back from 6"):
        clock.advance_to(5.999)


def test_the_monotonic_clock_is_that_of_the_machine_and_sleeps() -> None:
    clock = MonotonicClock()
    start_s = clock.now_s()
    assert abs(start_s - time.clock_gettime(time.CLOCK_MONOTONIC)) < 0.5
    clock.sleep_until(start_s - 100.0)
    clock.sleep_until(start_s + 0.01)
    assert clock.now_s() >= start_s + 0.01


def test_inline_work_is_done_after_its_declared_cost() -> None:
    clock = ManualClock(1.0)
    executor = InlineExecutor(clock)
    pending = executor.submit(lambda: 42, cost_s=0.25)
    assert not pending.done()
    clock.advance_to(1.249)
    assert not pending.done()
    clock.advance_to(1.25)
    assert pending.done()
    assert pending.result() == 42
    executor.close()


def test_inline_work_raises_where_it_is_submitted() -> None:
    with pytest.raises(ZeroDivisionError):
        InlineExecutor(ManualClock()).submit(lambda: 1 // 0, cost_s=0.0)


def test_threaded_work_never_overlaps_and_raises_at_its_result() -> None:
    executor = ThreadExecutor("plan")
    gate, order = threading.Event(), []

    def first() -> int:
        gate.wait(5.0)
        order.append(1)
        return 1

    a = executor.submit(first, cost_s=0.0)
    b = executor.submit(lambda: order.append(2), cost_s=0.0)
    c = executor.submit(lambda: 1 // 0, cost_s=0.0)
    assert not a.done()
    assert not b.done()
    gate.set()
    assert a.result() == 1
    b.result()
    with pytest.raises(ZeroDivisionError):
        c.result()
    assert order == [1, 2]
    executor.close()


def test_closing_does_not_wait_for_work_that_does_not_return() -> None:
    executor = ThreadExecutor("plan", close_timeout_s=0.05)
    begun, gate = threading.Event(), threading.Event()

    def stick() -> bool:
        begun.set()
        return gate.wait(60.0)

    stuck = executor.submit(stick, cost_s=0.0)
    behind = executor.submit(lambda: 1 // 0, cost_s=0.0)
    assert begun.wait(60.0)
    executor.close()
    assert not stuck.done()
    gate.set()
    assert stuck.result()
    with pytest.raises(CancelledError):
        behind.result()


PROGRAM = """
import threading
from uav_recon.clock import ThreadExecutor
executor = ThreadExecutor("plan", close_timeout_s=0.05)
begun = threading.Event()
executor.submit(lambda: (begun.set(), threading.Event().wait()), cost_s=0.0)
begun.wait(60.0)
executor.close()
"""


def test_a_process_ends_beside_work_that_does_not_return() -> None:
    assert subprocess.run([sys.executable, "-c", PROGRAM], timeout=60.0, check=False).returncode == 0


def test_closing_waits_for_running_work() -> None:
    executor = ThreadExecutor("write")
    begun, gate, done = threading.Event(), threading.Event(), []

    def write() -> None:
        begun.set()
        gate.wait(60.0)
        done.append(1)

    executor.submit(write, cost_s=0.0)
    assert begun.wait(60.0)
    threading.Timer(0.05, gate.set).start()
    executor.close()
    assert done == [1]


def test_detached_work_that_never_returns_delays_no_other_work_and_no_end() -> None:
    executor, go_on = DetachedExecutor("test"), threading.Event()
    stuck, quick = executor.submit(go_on.wait, 0.0), executor.submit(lambda: 7, 0.0)
    assert quick.result() == 7
    assert not stuck.done()
    executor.close()
    go_on.set()
    assert stuck.result()


def test_an_exception_of_detached_work_is_raised_by_its_result() -> None:
    with pytest.raises(ZeroDivisionError):
        DetachedExecutor("test").submit(lambda: 1 // 0, 0.0).result()
