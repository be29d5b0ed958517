"""The campaign: which flights it is made of, what the result of a scenario says, and how it is written down."""

from __future__ import annotations

import html
import json
import math
from pathlib import Path

import numpy as np
import pytest
from made_up_evidence import evidence

from sitl.apps.sim_options import AUTOPILOTS
from sitl.faults.flight_evidence import FlightEvidence
from sitl.faults.flights.campaign import Campaign, _line, _missed, faults, summary
from sitl.faults.flights.fault_flight import FaultCase, FaultRecord, fly_together
from sitl.faults.flights.fault_options import FaultOptions
from sitl.faults.judges import reaction_metrics as m
from sitl.faults.judges.invariants import violations
from sitl.faults.report.campaign_page import render
from sitl.faults.report.scenario_result import result_of
from sitl.faults.table.all_scenarios import SCENARIOS, TABLE
from sitl.faults.table.scenario import Limit, Scenario, ScenarioVerdict, judge
from uav_recon.app.option_validation import UsageError

GAP = Limit("gap", m.longest_gap(), 0.25, "s")
CLEAR = Limit("clearance", m.clearance, 0.4, "m", at_least=True, ardupilot=0.6)
ROW = Scenario("X1", "a <hazard>", "something", limits=(GAP, CLEAR))


def test_rows_come_in_the_tables_order() -> None:
    options = Campaign.of(FaultOptions(only="B4, A1", autopilot="px4", seeds=2, out=Path("/somewhere")))
    assert [scenario.id for scenario in options.scenarios] == ["A1", "B4"]
    cases = options.cases(SCENARIOS["A1"], "px4")
    assert [case.number for case in cases] == [0, 1, 2, 3, 4, 5]
    assert cases[1].out == Path("/somewhere/A1-px4-1")
    assert options.cases(SCENARIOS["A4"], "px4") == []
    assert FaultOptions().autopilots == AUTOPILOTS
    assert {scenario.id for scenario in Campaign.of(FaultOptions(real_time=True)).scenarios} == {
        *(f"A{k}" for k in range(1, 12)),
        "A6m",
        "C2",
        "D6",
        "G2",
        "G3",
    }
    with pytest.raises(UsageError, match="B4: cannot run in real time"):
        Campaign.of(FaultOptions(only="B4", real_time=True))
    assert Campaign.of(FaultOptions()).scenarios == TABLE


def test_a_real_firmware_flies_what_it_has_the_means_for(tmp_path: Path) -> None:
    binary = tmp_path / "arducopter"
    with pytest.raises(UsageError, match="no such file"):
        Campaign.of(FaultOptions(autopilot="ardupilot", firmware=binary))
    binary.write_bytes(b"")
    with pytest.raises(UsageError, match="not executable"):
        Campaign.of(FaultOptions(autopilot="ardupilot", firmware=binary))
    binary.chmod(0o755)
    with pytest.raises(UsageError, match="--autopilot both: with --firmware want px4 or ardupilot"):
        Campaign.of(FaultOptions(firmware=binary))
    copter = Campaign.of(FaultOptions(autopilot="ardupilot", firmware=binary, jobs=4))
    names = {scenario.id for scenario in copter.scenarios}
    assert {"A1", "A6", "B1", "B4", "C4", "D2", "E1", "G6"} <= names
    assert not names & {"E5", "E7", "F1", "F2", "D7", "G9", "B11"}, "they need the insides of a simulated one, or are none"
    assert copter.options.live
    assert copter.cases(SCENARIOS["B1"], "ardupilot")[0].firmware == binary
    assert "E1" not in {scenario.id for scenario in Campaign.of(FaultOptions(autopilot="px4", firmware=binary)).scenarios}, (
        "nobody holds its sticks"
    )
    with pytest.raises(UsageError, match="E7: cannot run with a real ardupilot firmware"):
        Campaign.of(FaultOptions(only="E7", autopilot="ardupilot", firmware=binary))


def test_what_rows_have_in_common_is_flown_once() -> None:
    options = Campaign.of(FaultOptions(only="A1,A6,C7,F2,G7", seeds=2))
    groups = [[(case.scenario, case.autopilot, case.number) for case in group] for group in options.groups()]
    assert groups[:3] == [[("A1", "px4", 0), ("A6", "px4", 0)], [("C7", "px4", 0)], [("F2", "px4", 0)]]
    assert groups[3][0] == ("A1", "px4", 1)
    alone = [group for group in groups if group[0][2] >= 2]
    assert alone == [[("A1", autopilot, number)] for autopilot in AUTOPILOTS for number in range(2, 6)], (
        "A1 is flown more often"
    )
    assert sum(len(group) for group in groups) == 2 * (6 + 2 + 2 + 2)
    live = Campaign.of(FaultOptions(only="A1,A6", seeds=2, real_time=True)).groups()
    assert [len(group) for group in live] == [1] * 8, "and not in real time"


def test_twenty_seeds_are_sixty_of_the_five_rows_that_take_most_turns() -> None:
    options = Campaign.of(FaultOptions(seeds=20))
    often = [scenario.id for scenario in options.scenarios if len(options.cases(scenario, "px4")) == 60]
    assert often == ["A1", "B1", "B4", "E1", "F1"]


def test_seeds_can_begin_later_so_that_one_that_missed_is_flown_again(tmp_path: Path) -> None:
    options = Campaign.of(FaultOptions(only="B1,B3", autopilot="px4", seeds=1, seed0=7, out=tmp_path))
    assert [case.number for case in options.cases(SCENARIOS["B3"], "px4")] == [7]
    assert [case.number for case in options.cases(SCENARIOS["B1"], "px4")] == [7, 8, 9]
    assert options.cases(SCENARIOS["B3"], "px4")[0].out == tmp_path / "B3-px4-7"
    record = FaultRecord(FaultCase("B3", "px4", 7), ScenarioVerdict((0.30, 0.0), ("contact",)))
    assert _missed(record).startswith(
        "missed: change of the pose error 0.30 <= 0.05 m, contact (repeat: --only B3 --autopilot px4 "
        f"{record.case.how} --seeds 1 --seed0 7)"
    )
    assert "seed 7, 9" in _line(
        result_of(SCENARIOS["B3"], "px4", [record.verdict, ScenarioVerdict((0.0, 0.0), ()), record.verdict], first=7)
    )


@pytest.mark.parametrize(
    ("scenario", "reason"),
    [
        ("B11", r"no flight: B11 cannot be flown \(needs visual tracking, which is not included\)"),
        ("A5", r"A5 cannot run in lockstep\. Run it with --real-time\."),
        ("G9", r"G9-2h cannot run in lockstep\. Run it with --real-time\."),
        ("A4,A5", r"A4, A5 cannot run in lockstep\. Run them with --real-time\."),
    ],
)
def test_where_nothing_is_flown_at_all_nothing_has_passed(
    scenario: str, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(UsageError, match=reason):
        faults(FaultOptions(only=scenario, autopilot="px4", seeds=1))
    told = capsys.readouterr().out
    assert scenario.partition(",")[0] in told
    assert "not flown: " in told


def test_flights_that_are_there_are_not_flown_over(tmp_path: Path) -> None:
    (tmp_path / "A1-px4-0").mkdir()
    with pytest.raises(UsageError, match=r"already contains flights, e\.g\. A1-px4-0"):
        faults(FaultOptions(only="A1", autopilot="px4", seeds=1, out=tmp_path))


@pytest.mark.parametrize(
    ("words", "named"),
    [({"only": "A1,Z9"}, "Z9"), ({"only": "A1,"}, "no scenario ''"), ({"autopilot": "inav"}, "autopilot")],
)
def test_a_word_that_is_unknown_is_told(words: dict[str, str], named: str) -> None:
    with pytest.raises(UsageError, match=named):
        Campaign.of(FaultOptions(**words))  # type: ignore[arg-type]


def test_a_flight_is_held_to_its_bars() -> None:
    verdict = judge(ROW, evidence(), [])
    assert verdict.passed(ROW, "px4")
    assert not verdict.passed(ROW, "ardupilot"), "whose limit is higher"
    assert not judge(ROW, evidence(obstacle_distance_m=np.full(600, 0.3)), []).passed(ROW, "px4")
    assert not judge(ROW, evidence(), ["contact"]).passed(ROW, "px4")
    assert not judge(ROW, evidence(onset_s=math.inf), []).passed(ROW, "px4"), "a fault that never came proves nothing"


def test_a_program_that_breaks_fails_its_rows_and_says_with_what(monkeypatch: pytest.MonkeyPatch) -> None:
    def breaks(*_: object) -> FlightEvidence:
        raise OSError("gone")

    monkeypatch.setattr("sitl.faults.flights.fault_flight.flight", breaks)
    records = fly_together([FaultCase(scenario, "px4", 0) for scenario in ("A1", "A2")])
    assert [record.case.scenario for record in records] == ["A1", "A2"]
    for record in records:
        assert record.verdict.broken == ("OSError: gone",)
        assert not record.verdict.passed(SCENARIOS[record.case.scenario], "px4")
        assert "Traceback" in record.trace


def test_a_row_is_as_good_as_its_worst_flight() -> None:
    result = result_of(
        ROW,
        "px4",
        [ScenarioVerdict((0.03, 0.5), ()), ScenarioVerdict((0.30, 0.45), ()), ScenarioVerdict((0.05, 0.7), ("contact",))],
    )
    assert (result.kept, result.seeds, result.passed, result.missed) == (1, 3, False, (1, 2))
    assert result.tree()["missed"] == [1, 2]
    assert result.worst == (0.30, 0.45)
    tree = result.tree()
    assert (tree["figure"], tree["limit"], tree["unit"], tree["passed"]) == (0.3, 0.25, "s", False)
    assert "gap 0.30 <= 0.25 s" in result.sentence()
    assert result.remarks == ("contact",)


def test_a_result_names_the_firmware_that_flew() -> None:
    result = result_of(ROW, "ardupilot", [ScenarioVerdict((0.03, 0.7), ())], "4.8.0 (8f898471)")
    assert (result.tree()["tier"], result.tree()["firmware"]) == ("T1", "4.8.0 (8f898471)")
    assert "<td>ardupilot 4.8.0 (8f898471)</td>" in render([result])
    assert result_of(ROW, "px4", []).tree()["tier"] == "T0"


def test_what_never_came_is_null_and_breaks_the_bar() -> None:
    result = result_of(ROW, "px4", [ScenarioVerdict((math.inf, math.nan), ())])
    assert result.passed is False
    assert result.tree()["figure"] is None
    assert "gap never" in result.sentence()
    json.dumps(result.tree(), allow_nan=False)


def test_a_row_that_cannot_be_flown_says_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert json.dumps(result_of(SCENARIOS["A5"], "px4", []).tree()), "one that has limits, but flies only in real time"
    options = FaultOptions(only="G7", autopilot="px4", jobs=1, json=tmp_path / "f.json", out=tmp_path / "out")
    with pytest.raises(UsageError, match="G7 cannot be flown"):
        faults(options)
    assert "not flown: needs hardware" in capsys.readouterr().out
    scenario = json.loads((tmp_path / "f.json").read_text())["scenarios"][0]
    assert set(scenario) >= {"id", "tier", "autopilot", "seeds", "passed", "figure", "limit", "unit"}
    assert scenario["passed"] is None
    assert "not flown" in (tmp_path / "out" / "faults.html").read_text()


def test_the_page_tells_figures_and_keeps_its_tags() -> None:
    page = render([result_of(ROW, "px4", [ScenarioVerdict((0.3, 0.5), ("contact <1>",))])])
    assert "0 of 1 scenarios passed" in page
    assert "gap 0.30 &lt;= 0.25 s" in page
    assert "a &lt;hazard&gt;" in page
    assert "contact &lt;1&gt;" in page


def test_the_page_shows_how_much_of_each_bar_is_used_up_and_how_to_fly_what_missed() -> None:
    page = render([result_of(ROW, "px4", [ScenarioVerdict((0.1, 0.5), ()), ScenarioVerdict((0.3, 0.5), ())], first=7)])
    assert '<i class="over"><u style="width:100%"></u></i>gap 0.30' in page
    assert '<i><u style="width:80%"></u></i>clear' in page
    assert "faults --only X1 --autopilot px4 --seeds 1 --seed0 8" in page
    assert "--seed0 7" not in page
    assert "failed: X1 px4" in page


@pytest.mark.parametrize(
    ("live", "firmware", "errors", "how"),
    [
        (False, None, 0.0, "--camera-errors 0 "),
        (True, None, 1.0, "--real-time --camera-errors 1 "),
        (True, Path("/a b/px4"), 0.5, "--firmware '/a b/px4' --camera-errors 0.5 "),
    ],
)
def test_what_missed_is_flown_again_the_same_way(live: bool, firmware: Path | None, errors: float, how: str) -> None:
    case = FaultCase("B3", "px4", 7, live=live, firmware=firmware, camera_errors=errors)
    verdict, again = ScenarioVerdict((0.30, 0.0), ()), f"--only B3 --autopilot px4 {how}--seeds 1 --seed0 7"
    assert f"(repeat: {again})" in _missed(FaultRecord(case, verdict))
    assert again in html.unescape(render([result_of(SCENARIOS["B3"], "px4", [verdict], first=7, how=case.how)]))


def test_the_camera_errors_of_a_campaign_are_those_of_its_flights() -> None:
    options = Campaign.of(FaultOptions(only="A1", autopilot="px4", seeds=1, camera_errors="0.5"))
    cases = [case for group in options.groups() for case in group]
    assert {(case.camera_errors, case.stage.camera_errors) for case in cases} == {(0.5, 0.5)}
    live = Campaign.of(FaultOptions(only="A1", autopilot="px4", seeds=1, real_time=True, camera_errors="none")).groups()
    assert {case.camera_errors for group in live for case in group} == {0.0}
    with pytest.raises(UsageError, match="--camera-errors bad: want none, default or a factor of 0 to 2"):
        Campaign.of(FaultOptions(camera_errors="bad"))


def test_the_summary_counts_flights_that_touched_something() -> None:
    touched = tuple(violations(evidence(obstacle_distance_m=np.zeros(600))))
    assert any(words.startswith("contact") for words in touched)
    verdicts = [ScenarioVerdict((0.03, 0.5), ()), ScenarioVerdict((0.03, 0.5), touched)]
    told = summary([result_of(ROW, "px4", verdicts), result_of(ROW, "ardupilot", [])])
    assert told == {"scenarios": 1, "scenarios_failed": 1, "flights": 2, "flights_failed": 1, "contacts": 1}
