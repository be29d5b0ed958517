"""Stamps of a device on the companion's clock: within milliseconds, whatever the device counts, or refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.sensors.stamp_clock import HOLD_S, ClockOffset, DeviceClocks, StampDomain, fit_below

HARDWARE, SYSTEM, GLOBAL = StampDomain.HARDWARE, StampDomain.SYSTEM, StampDomain.GLOBAL
WALL_S = 1.7e9  # system time at the companion's time 0


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    drift=st.floats(-100e-6, 100e-6),
    rate_hz=st.sampled_from([15, 30, 60, 200]),
    jitter_s=st.floats(0.0005, 0.010),
    origin_s=st.floats(-1e5, 1e5),
)
def test_the_offset_is_known_to_three_milliseconds_after_five_seconds(
    seed: int, drift: float, rate_hz: int, jitter_s: float, origin_s: float
) -> None:
    """Delays: 20 ms at least, exponential jitter, and one in twenty later by up to 0.3 s."""
    rng, offset = np.random.default_rng(seed), ClockOffset()
    for k in range(25 * rate_hz):
        taken_s = 100.0 + k / rate_hz
        late_s = rng.exponential(jitter_s) + (rng.uniform(0.0, 0.3) if rng.random() < 0.05 else 0.0)
        arrival_s, stamp_s = taken_s + 0.020 + late_s, origin_s + taken_s * (1.0 + drift)
        offset.update(arrival_s - stamp_s, arrival_s)
        if k >= 5 * rate_hz:
            assert abs(stamp_s + offset.at(arrival_s) - (taken_s + 0.020)) < 0.003
    assert offset.resets == 0
    assert offset.drift_fault() is None


def test_drift_is_followed_between_the_shortest_delays() -> None:
    """Only one stamp in two seconds comes without delay; its offset holds for those after it."""
    offset = ClockOffset()
    for k in range(600):
        arrival_s = 100.0 + k / 30
        stamp_s = (arrival_s - (0.0 if k % 60 == 0 else 0.02)) * (1.0 - 200e-6)
        offset.update(arrival_s - stamp_s, arrival_s)
        if k > 450:
            assert arrival_s * (1.0 - 200e-6) + offset.at(arrival_s) == pytest.approx(arrival_s, abs=1e-4)


@given(st.lists(st.tuples(st.floats(0.0, 0.1), st.floats(-1.0, 1.0)), min_size=2, max_size=80))
def test_the_line_lies_below_all_points_and_touches_one(steps: list[tuple[float, float]]) -> None:
    x = np.cumsum([0.01 + step for step, _ in steps])
    y = np.array([value for _, value in steps])
    base, ordinate, slope = fit_below(list(zip(x.tolist(), y.tolist(), strict=True)))
    above = y - (ordinate + slope * (x - base))
    assert above.min() == pytest.approx(0.0, abs=1e-9)
    assert abs(slope) <= 300e-6


def _feed(
    clocks: DeviceClocks, start_s: float, seconds: float, **streams: tuple[StampDomain, float, float, float]
) -> dict[str, float]:
    """Send stamps of several streams: (domain, origin of their clock, shortest delay, rate).

    Returns the error of the newest stamp of each, against the instant of capture.
    """
    rng = np.random.default_rng(1)
    times = sorted(
        (start_s + k / rate_hz, name) for name, (_, _, _, rate_hz) in streams.items() for k in range(round(seconds * rate_hz))
    )
    errors = {}
    for taken_s, name in times:
        domain, origin_s, delay_s, _ = streams[name]
        arrival_s = taken_s + delay_s + rng.exponential(0.001)
        stamp_s = taken_s + origin_s if domain is not SYSTEM else arrival_s + origin_s
        errors[name] = clocks.monotonic_s(name, domain, stamp_s, arrival_s, arrival_s + WALL_S) - taken_s
    return errors


def test_depth_is_as_old_as_its_delay_where_the_gyro_shares_its_clock() -> None:
    """Depth alone cannot tell its own delay; samples of the same clock that come faster can."""
    alone = _feed(DeviceClocks(), 100.0, 6.0, depth=(HARDWARE, -90.0, 0.045, 30))
    assert alone["depth"] == pytest.approx(0.045, abs=0.002)
    both = _feed(DeviceClocks(), 100.0, 6.0, depth=(HARDWARE, -90.0, 0.045, 30), gyro=(HARDWARE, -90.0, 0.003, 200))
    assert both["depth"] == pytest.approx(0.003, abs=0.002)
    assert both["gyro"] == pytest.approx(0.003, abs=0.002)


@pytest.mark.parametrize("apart_s", [0.2, -0.2, 1.3, 5000.0])
def test_two_hardware_clocks_keep_their_own_offsets_and_are_said(apart_s: float) -> None:
    clocks = DeviceClocks()
    errors = _feed(clocks, 100.0, 6.0, depth=(HARDWARE, -90.0, 0.03, 30), gyro=(HARDWARE, -90.0 + apart_s, 0.003, 200))
    assert errors["depth"] == pytest.approx(0.03, abs=0.002)
    assert errors["gyro"] == pytest.approx(0.003, abs=0.002)
    assert clocks.apart_s("gyro", "depth", 106.0) == pytest.approx(-apart_s, abs=0.05)
    assert clocks.faults() == []


def test_depth_and_gyro_in_different_domains_each_follow_their_own() -> None:
    clocks = DeviceClocks()
    errors = _feed(clocks, 100.0, 6.0, depth=(SYSTEM, WALL_S, 0.045, 30), gyro=(HARDWARE, -90.0, 0.003, 200))
    assert errors["depth"] == pytest.approx(0.045, abs=0.005)  # stamped on arrival: its delay cannot be seen
    assert errors["gyro"] == pytest.approx(0.003, abs=0.002)
    assert clocks.domains() == {"depth": SYSTEM, "gyro": HARDWARE}


def test_global_time_is_kept_unless_it_is_ahead_of_the_arrivals() -> None:
    kept = _feed(DeviceClocks(), 100.0, 6.0, depth=(GLOBAL, WALL_S, 0.045, 30), gyro=(GLOBAL, WALL_S, 0.003, 200))
    assert kept == pytest.approx({"depth": 0.0, "gyro": 0.0}, abs=1e-6)
    ahead = _feed(
        DeviceClocks(), 100.0, 6.0, depth=(GLOBAL, WALL_S + 0.015, 0.045, 30), gyro=(GLOBAL, WALL_S + 0.015, 0.003, 200)
    )
    assert ahead == pytest.approx({"depth": 0.003, "gyro": 0.003}, abs=0.002)


@pytest.mark.parametrize("step_s", [0.25, 3600.0, -0.25, -3600.0])
def test_a_clock_that_was_set_is_followed_after_a_hold(step_s: float) -> None:
    clocks = DeviceClocks()
    _feed(clocks, 100.0, 6.0, depth=(HARDWARE, -90.0, 0.02, 30))
    assert clocks.settled("depth", 106.0)
    errors = _feed(clocks, 106.0, 0.8, depth=(HARDWARE, -90.0 + step_s, 0.02, 30))
    assert abs(errors["depth"]) < 0.03
    set_s = 106.0 if step_s != -0.25 else 106.5  # that it is not a burst of late frames shows after half a second
    assert not clocks.settled("depth", set_s + 0.45)
    assert clocks.settled("depth", set_s + 0.1 + HOLD_S)
    assert clocks.faults() == []


@pytest.mark.parametrize("streams", [("depth",), ("depth", "gyro")])
@pytest.mark.parametrize("step_s", [-0.05, -0.12, -0.2, -0.3, -0.8, -5.0])
def test_a_global_time_that_steps_back_is_anchored_on_the_arrivals_and_said(step_s: float, streams: tuple[str, ...]) -> None:
    """As in librealsense PR 15360: the stamps stayed that old for good."""
    clocks = DeviceClocks()
    delay_s, rate_hz = {"depth": 0.02, "gyro": 0.001}, {"depth": 30.0, "gyro": 200.0}

    def fed(start_s: float, seconds: float, back_s: float) -> dict[str, float]:
        origin_s = {name: WALL_S + (back_s if name in streams else 0.0) for name in delay_s}
        told = {name: (GLOBAL, origin_s[name], delay_s[name], rate_hz[name]) for name in delay_s}
        return _feed(clocks, start_s, seconds, **told)

    assert fed(100.0, 20.0, 0.0) == pytest.approx({"depth": 0.0, "gyro": 0.0}, abs=0.002)
    assert fed(120.0, 0.8, step_s) == pytest.approx({"depth": 0.0, "gyro": 0.0}, abs=0.006)
    for name in delay_s:
        behind_s = clocks.behind_s(name, 120.8)
        assert behind_s == (pytest.approx(-step_s, abs=0.005) if name in streams else None)
    assert fed(120.8, 60.0, step_s) == pytest.approx({"depth": 0.0, "gyro": 0.0}, abs=0.004)
    assert clocks.settled("depth", 180.0)
    assert clocks.apart_s("depth", "gyro", 180.0) is None
    assert clocks.faults() == []
    fed(180.8, 2.0, 0.0)  # it is right again
    assert clocks.behind_s("depth", 182.8) is None
    assert fed(182.8, 1.0, 0.0) == pytest.approx({"depth": 0.0, "gyro": 0.0}, abs=0.004)


def test_a_global_time_that_is_behind_from_the_start_is_anchored_on_the_arrivals() -> None:
    clocks = DeviceClocks()
    errors = _feed(clocks, 100.0, 3.0, depth=(GLOBAL, WALL_S - 0.4, 0.02, 30))
    assert errors["depth"] == pytest.approx(0.02, abs=0.004)  # its delay cannot be seen
    assert clocks.behind_s("depth", 103.0) == pytest.approx(0.42, abs=0.005)


@pytest.mark.parametrize("delay_s", [0.045, 0.14])
def test_a_slow_transport_is_no_clock_that_is_behind(delay_s: float) -> None:
    """Nor frames that come late for a while, nor two that come in the wrong order."""
    clocks = DeviceClocks()
    assert _feed(clocks, 100.0, 6.0, depth=(GLOBAL, WALL_S, delay_s, 30))["depth"] == pytest.approx(0.0, abs=1e-6)
    assert clocks.behind_s("depth", 106.0) is None
    for k, taken_s in enumerate((106.033, 106.0, *np.arange(106.066, 109.0, 0.033).tolist())):
        late_s = 0.06 if 20 <= k < 50 else 0.0
        arrival_s = max(taken_s, 106.033) + delay_s + late_s
        stamp_s = clocks.monotonic_s("depth", GLOBAL, taken_s + WALL_S, arrival_s, arrival_s + WALL_S)
        assert stamp_s == pytest.approx(taken_s, abs=1e-6)
    assert clocks.behind_s("depth", 109.0) is None


def test_no_stamp_is_later_than_its_arrival() -> None:
    clocks, rng = DeviceClocks(), np.random.default_rng(5)
    for k in range(3000):
        arrival_s = 100.0 + k / 200
        stamp_s = arrival_s + float(rng.normal(0.0, 0.05))
        assert clocks.monotonic_s("gyro", (HARDWARE, GLOBAL)[int(rng.integers(2))], stamp_s, arrival_s, arrival_s) <= arrival_s


@pytest.mark.parametrize("seconds_per_s", [0.0, 0.001, 0.9, 1.1, 1000.0])
def test_stamps_that_count_no_seconds_are_a_fault(seconds_per_s: float) -> None:
    clocks = DeviceClocks()
    for k in range(360):
        arrival_s = 100.0 + k / 30
        clocks.monotonic_s("depth", HARDWARE, 5.0 + seconds_per_s * arrival_s, arrival_s, arrival_s + WALL_S)
    assert [fault.stream for fault in clocks.faults()] == ["depth"]


def _fed_in_order(
    clocks: DeviceClocks, domain: StampDomain, step_s: float, delay_s: tuple[float, float], seed: int, streams: tuple[str, ...]
) -> tuple[list[float], list[float]]:
    """Send depth at 30 Hz whose delay varies, in the order of capture, and a gyro; from 40 s on clocks are off by step_s.

    Returns the errors of the depth stamps before the step, and from 1.5 s after it on.
    """
    rng, origin_s = np.random.default_rng(seed), -90.0 if domain is HARDWARE else WALL_S
    arrivals = [(k / 200 + 0.001 + rng.exponential(0.0003), k / 200, "gyro") for k in range(50 * 200)]
    newest_s = 0.0
    for k in range(50 * 30):
        newest_s = max(newest_s + 1e-4, k / 30 + rng.uniform(*delay_s))
        arrivals.append((newest_s, k / 30, "depth"))
    before: list[float] = []
    after: list[float] = []
    for arrival_s, taken_s, name in sorted(arrivals):
        off_s = step_s if taken_s > 40.0 and name in streams else 0.0
        stamp_s = clocks.monotonic_s(name, domain, taken_s + origin_s + off_s, arrival_s, arrival_s + WALL_S)
        if name == "depth" and not 40.0 <= taken_s < 41.5 and taken_s > 2.0:
            (before if taken_s < 40.0 else after).append(stamp_s - taken_s)
    return before, after


@pytest.mark.parametrize("domain", [GLOBAL, HARDWARE])
@pytest.mark.parametrize("delay_s", [(0.02, 0.021), (0.04, 0.15)])
@pytest.mark.parametrize("seed", range(3))
def test_arrivals_that_vary_are_no_step(domain: StampDomain, delay_s: tuple[float, float], seed: int) -> None:
    clocks = DeviceClocks()
    for errors in _fed_in_order(clocks, domain, 0.0, delay_s, seed, ()):
        assert max(map(abs, errors)) < 0.002
    assert clocks.behind_s("depth", 50.0) is None
    assert clocks.apart_s("depth", "gyro", 50.0) is None
    assert clocks.settled("depth", 50.0)


@pytest.mark.parametrize("domain", [GLOBAL, HARDWARE])
@pytest.mark.parametrize("delay_s", [(0.02, 0.021), (0.04, 0.15)])
@pytest.mark.parametrize("streams", [("depth",), ("depth", "gyro")])
@pytest.mark.parametrize("step_s", [-0.05, -0.3, -0.8, -3.7])
def test_a_step_back_is_taken_out_while_arrivals_vary(
    domain: StampDomain, delay_s: tuple[float, float], streams: tuple[str, ...], step_s: float
) -> None:
    """A depth clock alone, too: by 0.05 s its offset stays within that of a delay, and it had shared the gyro's."""
    clocks = DeviceClocks()
    _, after = _fed_in_order(clocks, domain, step_s, delay_s, 1, streams)
    assert abs(float(np.median(after))) < 0.006
    assert max(map(abs, after)) < 0.03
    if domain is GLOBAL:
        assert clocks.behind_s("depth", 50.0) == pytest.approx(-step_s, abs=0.03)
    elif streams == ("depth",):
        assert clocks.apart_s("depth", "gyro", 50.0) == pytest.approx(-step_s, abs=0.06)
