"""Sweep: its flights, its records, and that no failure stops it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from sitl.apps.sweep import cases, summary, sweep
from sitl.apps.sweep_case import Case, Record, fly_case
from sitl.apps.sweep_options import SweepOptions
from sitl.faults.flights.fault_options import FaultOptions
from uav_recon import json_codec
from uav_recon.app.option_validation import UsageError
from uav_recon.errors import UserError

BROKEN = Case("/nowhere", 0, 0.2, "adaptive", "fixed:15", "fast", 8)


def test_more_jobs_than_fit_in_memory_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sitl.apps.sim_options.memory_gb", lambda: 4.1)
    assert SweepOptions(jobs=5).jobs == 5
    for parse in (SweepOptions, FaultOptions):
        with pytest.raises(UsageError, match=r"^--jobs 6: want 1 to 5; each may use 0\.8 GB of memory$") as caught:
            parse(jobs=6)
        assert caught.value.code == 2


def test_all_combinations_are_flown_before_the_next_seed() -> None:
    options = SweepOptions(flights=9, seed0=4, scenes="random,built-in", radii="0.15,0.3", variants="adaptive,explore")
    flown = list(cases(options))
    assert len(flown) == len(set(flown)) == 9
    assert {case.seed for case in flown[:8]} == {4}
    assert flown[8].seed == 5
    assert [case.scene for case in flown[:3]] == ["random:4", None, "random:4"]
    assert {(case.radius_m, case.variant) for case in flown[:8]} == {
        (r, v) for r in (0.15, 0.3) for v in ("adaptive", "explore")
    }


def test_mounts_and_autopilots_are_combined_and_each_case_repeats_its_own() -> None:
    options = SweepOptions(flights=6, scenes="built-in", mount="fixed:0,fixed:15,gimbal", autopilot="both", pose="corrected")
    flown = list(cases(options))
    assert {(case.mount, case.autopilot) for case in flown} == {
        (mount, autopilot) for mount in ("fixed:0", "fixed:15", "gimbal") for autopilot in ("px4", "ardupilot")
    }
    assert "--mount gimbal --camera fast --autopilot ardupilot --camera-errors 1 --pose corrected" in flown[-1].command()


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ({"radii": "0.2,x"}, "radii"),
        ({"radii": "9"}, "radii"),
        ({"range_up_deg": 61.0}, "--range-up 61: want 5 to 60 degrees"),
        ({"variants": "fast"}, "variants"),
        ({"camera": "d415"}, "camera"),
        ({"camera_errors": "many"}, "--camera-errors many: want none, default or a factor of 0 to 2"),
        ({"autopilot": "cube"}, "--autopilot cube: want one of px4, ardupilot, both"),
        ({"pose": "gps"}, "--pose gps: want one of stream, corrected, slam, autopilot"),
        ({"mount": "gimbal,foo"}, "--mount foo: want gimbal, or fixed:DEG"),
        ({"mount": "foo"}, "--mount foo: want gimbal, or fixed:DEG"),
        (
            {"scenes": "/nope"},
            "--scenes /nope: no such scene; want random, small, flat, corridor, hall, l-shape, dead-end, tall, random:SEED, ",
        ),
        ({"scenes": ""}, "--scenes : no such scene"),
        ({"scenes": "random,"}, "--scenes : no such scene"),
        ({"scenes": "random:-1"}, "--scenes random:-1: no such scene"),
    ],
)
def test_an_invalid_option_is_named(words: dict[str, str], named: str) -> None:
    with pytest.raises(UsageError, match=named):
        SweepOptions(**words)  # type: ignore[arg-type]


def test_a_failed_flight_is_recorded_with_its_seed() -> None:
    record = fly_case(BROKEN, truth=False)
    assert record.case == BROKEN
    assert record.bad
    assert "no such scene" in record.error
    assert "Traceback" in record.trace
    assert "--scene /nowhere --seed 0" in record.case.command()
    assert "--camera-errors 0 --pose stream --views 8" in record.case.command()


def test_the_cases_have_the_camera_errors_of_the_sweep_and_old_records_have_none() -> None:
    (case,) = cases(SweepOptions(flights=1, camera_errors="0.5"))
    assert case.camera_errors == 0.5
    assert "--camera-errors 0.5" in case.command()
    tree = json_codec.to_tree(BROKEN)
    del tree["camera_errors"]
    assert json_codec.from_tree(Case, tree).camera_errors == 0.0


def test_the_cases_have_the_range_finder_of_the_sweep_and_old_records_have_none() -> None:
    (case,) = cases(SweepOptions(flights=1, range_up_deg=27.0))
    assert "--range-up 27" in case.command()
    (without,) = cases(SweepOptions(flights=1))
    assert "--range-up" not in without.command()
    tree = json_codec.to_tree(BROKEN)
    del tree["range_up_deg"]
    assert json_codec.from_tree(Case, tree).range_up_deg is None


def test_the_cases_have_the_flow_module_of_the_sweep_and_old_records_have_none() -> None:
    (case,) = cases(SweepOptions(flights=1, flow=True))
    assert case.flow
    assert case.command().split()[-1] == "--flow"
    (without,) = cases(SweepOptions(flights=1))
    assert "--flow" not in without.command()
    tree = json_codec.to_tree(BROKEN)
    del tree["flow"]
    assert json_codec.from_tree(Case, tree).flow is False


def test_a_record_is_read_back_unchanged() -> None:
    record = Record(BROKEN, "completed", "enough", flight_s=12.5, contacts=0)
    assert json_codec.from_text(Record, json_codec.to_line(record)) == record


def test_a_contact_is_bad_and_an_abort_is_not() -> None:
    assert Record(BROKEN, contacts=1).bad
    assert not Record(BROKEN, contacts=0).bad
    assert not Record(BROKEN, outcome="aborted: battery").bad


def test_a_sweep_resumes_after_the_recorded_flights(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    account = tmp_path / "sweep.json"
    (tmp_path / "empty").mkdir()
    options = SweepOptions(flights=2, scenes=str(tmp_path / "empty"), jobs=1, json=account)
    assert sweep(options) == 1
    assert "scene.json: cannot be read" in capsys.readouterr().out
    held = json.loads(account.read_text())["flights"]
    assert [tree["case"]["seed"] for tree in held] == [0, 1]
    for tree in held:
        tree["error"] = ""
    account.write_text(json.dumps({"flights": held}))
    assert sweep(options) == 0, "nothing is flown again"


def test_a_foreign_json_file_is_refused(tmp_path: Path) -> None:
    account = tmp_path / "sweep.json"
    account.write_text('{"flights": [{"seed": 1}]}')
    with pytest.raises(UserError, match="not a results file of `uav-recon sweep`"):
        sweep(SweepOptions(flights=1, json=account))


def test_a_summary_counts_all_flights_and_names_their_commits() -> None:
    records = [
        Record(BROKEN, "completed", contacts=0, min_clearance_m=0.2, flight_s=10.0, commit="abc"),
        Record(BROKEN, "aborted: battery", contacts=2, min_clearance_m=0.0, flight_s=30.0, commit="def"),
        Record(BROKEN, error="OSError: gone", commit="abc"),
    ]
    told = summary(records)
    assert (told["flights"], told["completed"], told["not_completed"]) == (3, 1, 2)
    assert (told["contacts"], told["errors"], told["min_clearance_m"]) == (2, 1, 0.0)
    assert (told["min_explored"], told["median_flight_s"]) == (None, 20.0)
    assert told["commits"] == ["abc", "def"]


def test_a_summary_counts_flights_that_ended_before_everything_was_seen() -> None:
    early = "2 place(s) left unseen"
    records = [
        Record(BROKEN, "completed", f"{early}: 2 viewed without result", ended_early=early),
        Record(BROKEN, "completed", "no frontiers left"),
        Record(BROKEN, "aborted: battery", early, ended_early=early),
    ]
    told = summary(records)
    assert (told["completed"], told["completed_early"], told["not_completed"]) == (2, 1, 1)
