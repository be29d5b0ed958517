"""Evaluation of gaps between setpoints, and rejection of invalid options."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sitl.bench.setpoints import setpoint_bench
from sitl.bench.setpoints.setpoint_bench import bench_setpoints, setpoint_regularity
from uav_recon.errors import UserError
from uav_recon.types.frames import FloatArray

STEADY = 100.0 + np.arange(1, 3000) / 30.0  # (2999,) to 200 s


def late(*gaps_ms: float) -> FloatArray:
    """Return the steady stream with delayed setpoints, so that it has gaps of these lengths."""
    arrivals = STEADY.copy()
    for k, gap_ms in enumerate(gaps_ms):
        arrivals[100 + 20 * k] += gap_ms / 1e3 - 1 / 30.0
        arrivals = np.delete(arrivals, (arrivals > arrivals[100 + 20 * k - 1]) & (arrivals < arrivals[100 + 20 * k]))
    return arrivals


def test_a_steady_stream_keeps_the_limits() -> None:
    told = setpoint_regularity(STEADY, 100.0, 200.0)
    assert told.kept
    assert told.setpoints == 2999
    assert [told.rate_hz, told.median_ms, told.p99_ms, told.max_ms] == pytest.approx([29.99, *[1000 / 30] * 3])


@pytest.mark.parametrize(("gaps_ms", "kept"), [
    ((249.0,), True), ((251.0,), False),
    ((74.0,) * 9, True), ((76.0,) * 9, False),
    ((49.0,) * 60, True), ((51.0,) * 60, False),
    ((51.0,) * 29, True), ((51.0,) * 30, False),
])  # fmt: skip
def test_each_limit_at_its_border(gaps_ms: tuple[float, ...], kept: bool) -> None:
    assert setpoint_regularity(late(*gaps_ms), 100.0, 200.0).kept is kept


@pytest.mark.parametrize("arrivals", [STEADY[:1500], STEADY[1500:], np.zeros(0)], ids=["it stops", "it begins late", "none"])
def test_silence_at_either_end_is_a_gap(arrivals: FloatArray) -> None:
    told = setpoint_regularity(arrivals, 100.0, 200.0)
    assert told.max_ms >= 49_000
    assert not told.kept


@pytest.mark.parametrize(("kept", "negative", "code"), [(True, False, 0), (False, False, 1), (True, True, 1), (False, True, 0)])
def test_the_negative_control_must_miss_the_limits_that_the_pilot_must_keep(
    kept: bool, negative: bool, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    told = setpoint_regularity(STEADY if kept else STEADY[:9], 100.0, 200.0)
    monkeypatch.setattr(setpoint_bench, "measure", lambda *_: told)
    assert bench_setpoints(1.0, negative, "px4", tmp_path / "told.json") == code
    assert ("missed" in capsys.readouterr().out) is not kept
    assert f'"kept": {"true" if kept else "false"}' in (tmp_path / "told.json").read_text()


@pytest.mark.parametrize(
    ("minutes", "autopilot", "json", "says"),
    [
        (0.05, "px4", None, "--minutes 0.05: want 0.1 to 120"),
        (121.0, "px4", None, "--minutes 121: want 0.1 to 120"),
        (float("nan"), "px4", None, "--minutes nan: want 0.1 to 120"),
        (1.0, "inav", None, "--autopilot inav: want one of px4, ardupilot"),
        (1.0, "px4", Path("/no/such/folder/x.json"), "--json /no/such/folder/x.json: no such folder"),
    ],
)
def test_invalid_options_are_a_one_line_error(minutes: float, autopilot: str, json: Path | None, says: str) -> None:
    with pytest.raises(UserError, match=f"^{says}"):
        bench_setpoints(minutes, False, autopilot, json)
