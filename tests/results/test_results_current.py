"""The generated pages are those of the claims and results beside them, and every claim can be measured."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer

from results import generate, measure, pages, revision_age, time_command
from results.claims import (
    CLAIMS,
    CURRENT,
    ROOT,
    Claim,
    ClaimError,
    Figure,
    Headline,
    Run,
    evaluate,
    load_claims,
    load_headlines,
    load_results,
)
from results.hazards_page import hazards_page
from sitl.faults.table.all_scenarios import TABLE
from uav_recon.cli.main import app
from uav_recon.measurement.machine_speed import REFERENCE_S, MachineSpeed
from uav_recon.measurement.result_file import save

CLAIMS_READ, RUNS = load_claims()
HEADER = {
    "command": "uav-recon bench planner", "commit": "abc1234", "changed": False, "date": "2026-11-26T01:02:03Z",
    "processor": "CPU", "cores": 2, "memory_gib": 23.4, "reference_job_s": 0.05, "contention": 1.0, "seconds": 12.0,
}  # fmt: skip
RUN = Run("planner", "uav-recon bench planner --json {json}", 1)
TIME = Figure("median", "stages/0/ms", at_most=2.5, unit="ms")
RECALL = Figure("recall", "quality/recall", at_least=0.9, digits=3)


def claim(*figures: Figure, runs: tuple[Run, ...] = (RUN,), timing: bool = False) -> Claim:
    return Claim("x", "It is fast.", runs, figures, "10 minutes", "a.md", timing)


def result(**values: Any) -> dict[str, Any]:
    return {"header": HEADER, "stages": [{"ms": 1.5}], "quality": {"recall": 0.95}, **values}


@pytest.mark.parametrize("name", list(generate.pages()))
def test_generated_files_are_up_to_date(name: str) -> None:
    there, wanted = (text.replace(pages.STALE, "") for text in ((ROOT / name).read_text("utf-8"), generate.pages()[name]))
    assert there == wanted, f"{name} differs from its sources: run `make results`"


def test_every_result_has_a_header_and_every_note_exists() -> None:
    for name, tree in load_results(RUNS).items():
        assert set(tree["header"]) == set(HEADER), name
    for one in CLAIMS_READ:
        assert not one.note or (ROOT / "results" / "notes" / one.note).is_file(), one.id


@pytest.mark.parametrize("name", list(RUNS))
def test_the_command_of_a_run_exists_and_writes_its_file(name: str) -> None:
    run = RUNS[name]
    assert run.path in run.command_line
    words = shlex.split(run.command)
    if words[0] == "uav-recon":
        group: Any = typer.main.get_command(app)
        for word in words[1:]:
            if not hasattr(group, "commands"):
                break
            assert word in group.commands, f"{CLAIMS}: {name}: no command {word}"
            group = group.commands[word]
        known = {option for parameter in group.params for option in parameter.opts}
        assert {word for word in words if word.startswith("--")} <= known, f"{CLAIMS}: {name}"
    elif words[:2] == ["python", "-m"]:
        assert words[2] in {"results.time_command", "results.mission_seeds"}
    elif words[0] == "python":
        assert (ROOT / words[1]).is_file()
    else:
        assert words[0] == "make"
        assert re.search(rf"^{words[1]}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)


def test_a_missing_key_is_an_error_that_names_file_and_key() -> None:
    with pytest.raises(ClaimError, match=rf"{CURRENT}/planner\.json: stages/0/s: no 's' there"):
        evaluate(claim(Figure("median", "stages/0/s", at_most=2.5)), {"planner": result()})
    with pytest.raises(ClaimError, match=r"planner\.json: header: no 'header' there"):
        evaluate(claim(TIME), {"planner": {"stages": [{"ms": 1.5}]}})
    with pytest.raises(ClaimError, match="'fast' is not a number"):
        evaluate(claim(Figure("median", "word", at_most=2.5)), {"planner": result(word="fast")})


def test_a_figure_is_compared_with_its_requirement() -> None:
    good = evaluate(claim(TIME, RECALL), {"planner": result()})
    assert (good.values, good.passed) == ((1.5, 0.95), True)
    assert not evaluate(claim(TIME, RECALL), {"planner": result(quality={"recall": 0.89})}).passed
    unknown = evaluate(claim(TIME, RECALL), {"planner": result(quality={"recall": None})})
    assert (unknown.values[1], unknown.passed) == (None, False), "null in a result fails the claim"
    assert evaluate(claim(Figure("median", "stages/0/ms")), {"planner": result()}).passed, "reported only"
    named = Figure("of b", "rows/name=b/ms", at_most=2.0, divided_by="stages/0/ms", scale=100.0)
    rows = [{"name": "a", "ms": 9.0}, {"name": "b", "ms": 0.015}]
    assert list(evaluate(claim(named), {"planner": result(rows=rows)}).values) == pytest.approx([1.0])
    word = Figure("outcome", "outcome", equals="completed")
    assert evaluate(claim(word), {"planner": result(outcome="completed")}).passed
    assert not evaluate(claim(word), {"planner": result(outcome="aborted: battery")}).passed


def test_of_several_runs_the_worst_figure_counts() -> None:
    runs = (RUN, Run("other", "uav-recon bench planner --json {json}", 1))
    other = result(stages=[{"ms": 2.6}], quality={"recall": 0.91})
    told = evaluate(claim(TIME, RECALL, runs=runs), {"planner": result(), "other": other})
    assert (told.values, told.passed) == ((2.6, 0.91), False)
    missing = evaluate(claim(TIME, runs=runs), {"planner": result()})
    assert (missing.measured, missing.reason) == (False, "no results/current/other.json yet")


def test_a_timing_beside_other_programs_is_not_used() -> None:
    busy = {"planner": result(header={**HEADER, "contention": 1.6})}
    assert evaluate(claim(TIME), busy).passed
    told = evaluate(claim(TIME, timing=True), busy)
    assert not told.measured
    assert "contention 1.60" in told.reason


def test_figures_of_two_commits_are_refused() -> None:
    runs = (RUN, Run("other", "uav-recon bench planner --json {json}", 1))
    later = result(header={**HEADER, "commit": "def5678"})
    with pytest.raises(
        ClaimError, match=r"other\.json: header/commit: def5678; allowed: abc1234, as the other figures of claim x"
    ):
        evaluate(claim(TIME, runs=runs), {"planner": result(), "other": later})
    with pytest.raises(ClaimError, match=r"planner\.json: summary/commits: def5678; allowed: abc1234"):
        evaluate(claim(TIME), {"planner": result(summary={"commits": ["abc1234+changed", "def5678"]})})
    assert evaluate(claim(TIME), {"planner": result(summary={"commits": ["abc1234"]})}).passed


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"views": 120}, r"report/views: 120; allowed 0 to 60"),
        ({"time_to_recall_s": {"0.95": 274.0}}, r"report/time_to_recall_s/0\.95: 274; allowed 0 to 183"),
    ],
)
def test_a_figure_that_cannot_be_is_refused_in_one_line(tmp_path: Path, values: dict[str, Any], said: str) -> None:
    flown = {"views": 60, "time_to_recall_s": {"0.95": 80.0}, "flight_time_s": 183.0}
    (tmp_path / CURRENT).mkdir(parents=True)
    path = tmp_path / CURRENT / "mission-real-time.json"
    path.write_text(json.dumps({"header": HEADER, "view_budget": 60, "report": flown}), encoding="utf-8")
    assert set(load_results(RUNS, tmp_path)) == {"mission-real-time"}
    path.write_text(json.dumps({"header": HEADER, "view_budget": 60, "report": flown | values}), encoding="utf-8")
    with pytest.raises(ClaimError, match=rf"{CURRENT}/mission-real-time\.json: {said} ") as caught:
        load_results(RUNS, tmp_path)
    assert "\n" not in str(caught.value)
    path.write_text(json.dumps({"header": HEADER, "report": flown}), encoding="utf-8")
    with pytest.raises(ClaimError, match="no 'view_budget' there"):
        load_results(RUNS, tmp_path)


def test_a_claim_measured_too_many_commits_ago_is_shown_as_stale(monkeypatch: pytest.MonkeyPatch) -> None:
    ages: dict[str, int | None] = {"abc1234": 60}
    monkeypatch.setattr(revision_age, "commits_since", lambda commit, _: ages[commit])
    outcome = evaluate(claim(TIME), {"planner": result()})
    line = Headline("time of a frame", "x", "median")
    for age, stale in ((0, False), (60, False), (61, True), (None, True)):
        ages["abc1234"] = age
        aged = revision_age.with_age(outcome, ROOT)
        assert ("| pass **STALE** |" in pages.results_page([aged])) == stale
        assert ("| 1.50 ms **STALE** |" in pages.readme_block([aged], [line])) == stale
    monkeypatch.undo()
    assert revision_age.commits_since("HEAD", ROOT) == 0
    assert revision_age.commits_since("0000000", ROOT) is None


def test_the_table_of_the_readme_has_one_value_a_line() -> None:
    line = Headline("time of a frame", "x", "median")
    slow = evaluate(claim(TIME), {"planner": result(stages=[{"ms": 9.1}])})
    assert pages.readme_block([slow], [line]).endswith("| time of a frame | 9.10 ms (**FAIL**: required ≤ 2.5 ms) |")
    missing = evaluate(claim(TIME), {})
    assert pages.readme_block([missing], [line]).endswith("| time of a frame | not measured |")
    assert len(load_headlines(CLAIMS_READ)) == 8
    with pytest.raises(ClaimError, match="has no figure"):
        load_headlines([claim(RECALL)])


def test_no_cell_of_the_limitations_is_long() -> None:
    for line in (ROOT / "docs" / "limitations.md").read_text(encoding="utf-8").splitlines():
        if line.startswith("|"):
            words = [len(cell.split()) for cell in line.strip("|").split("|")]
            assert words[0] <= 15, f"the first cell is a short line: {line}"
            assert max(words) < 60, line


def test_failing_claims_come_first_and_unmeasured_ones_have_a_reason() -> None:
    good, bad = (evaluate(claim(TIME), {"planner": result(stages=[{"ms": ms}])}) for ms in (1.0, 9.5))
    page = pages.results_page([good, bad, evaluate(claim(TIME), {})])
    measured, _, missing = page.partition("## Not measured yet")
    assert measured.index("**FAIL**") < measured.index("| pass |")
    assert "median 9.50 ms: FAIL" in measured
    assert "| 10 minutes | [note](notes/a.md) |" in missing
    assert "reference job 50.0 ms" in measured
    assert "3 claims: **1 fail**, 1 pass, 1 not measured" in page
    assert "[planner](current/planner.json)" in measured
    assert "`uav-recon bench planner --json results/current/planner.json`" in page


def test_history_is_only_appended_to() -> None:
    first = pages.history("", [evaluate(claim(TIME), {"planner": result()})])
    assert first.splitlines() == ["id,date,commit,value,pass", "x: median,2026-11-26T01:02:03Z,abc1234,1.5,pass"]
    assert pages.history(first, [evaluate(claim(TIME), {"planner": result()})]) == first
    later = {**HEADER, "date": "2026-11-27T00:00:00Z", "changed": True}
    second = pages.history(first, [evaluate(claim(TIME), {"planner": result(header=later, stages=[{"ms": 9.0}])})])
    assert second.startswith(first)
    assert second.splitlines()[-1] == "x: median,2026-11-27T00:00:00Z,abc1234+changed,9.0,FAIL"


def test_the_readme_keeps_everything_around_its_markers() -> None:
    text = f"# a\n{pages.BEGIN}\nold\n{pages.END}\nrest\n"
    assert pages.insert_block(text, "new") == f"# a\n{pages.BEGIN}\nnew\n{pages.END}\nrest\n"
    with pytest.raises(ClaimError, match=r"README\.md: wants"):
        pages.insert_block("# a\n", "new")


def test_a_file_that_no_run_writes_is_an_error(tmp_path: Path) -> None:
    (tmp_path / CURRENT).mkdir(parents=True)
    (tmp_path / CURRENT / "stray.json").write_text("{}")
    with pytest.raises(ClaimError, match=r"stray\.json: no run"):
        load_results(RUNS, tmp_path)


def test_the_hazards_page_shows_each_scenario_and_its_last_result() -> None:
    row = {"id": "A1", "autopilot": "px4", "seeds": 3, "missed": [1], "passed": False}
    page = hazards_page({"faults-one-seed": {"header": HEADER, "scenarios": [row]}})
    for scenario in TABLE:
        assert f"\n| {scenario.id} | " in page
    assert "lockstep: px4 **2 of 3 (abc1234)**" in page


def test_a_command_runs_with_this_interpreter() -> None:
    assert measure.shell_command("uav-recon sim --lockstep").endswith("-m uav_recon sim --lockstep")
    assert measure.shell_command("make safety JSON=x").startswith("make PYTHON=")
    assert measure.main(["--list", "help"]) == 0
    with pytest.raises(SystemExit):
        measure.main(["nothing"])


def test_durations_of_commands_are_written_and_a_failed_one_has_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    speed = MachineSpeed(REFERENCE_S, REFERENCE_S)
    monkeypatch.setattr("uav_recon.measurement.result_file.measure_machine_speed", lambda: speed)
    path = tmp_path / "x.json"
    assert time_command.main(["--json", str(path), "--times", "3", "good=true", "bad=false"]) == 1
    tree = json.loads(path.read_text(encoding="utf-8"))
    assert tree["seconds"]["good"] >= 0.0
    assert tree["seconds"]["bad"] is None
    assert tree["header"]["contention"] == 1.0
    save(path, {"seconds": 1.0})
    assert json.loads(path.read_text(encoding="utf-8"))["seconds"] == 1.0
    command = "said=echo starting; echo ready after 2 s; sleep 0.2"
    assert time_command.main(["--json", str(path), "--until", "ready after", command, "mute=true"]) == 0
    tree = json.loads(path.read_text(encoding="utf-8"))
    assert 0.0 <= tree["until"]["said"] < tree["seconds"]["said"] - 0.1
    assert tree["until"]["mute"] is None


@pytest.mark.parametrize("name", ["docs/limitations.md", "docs/hazards.md", "results/README.md", "results/notes/README.md"])
def test_links_of_a_page_lead_somewhere(name: str) -> None:
    page = ROOT / name
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), f"{name}: {target}"
