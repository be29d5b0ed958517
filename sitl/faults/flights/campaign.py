"""`uav-recon faults`: each hazard's scenario a line a row with the figure beside its bar, and a report."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from sitl.apps.sim_options import AUTOPILOTS, UsageError, check_jobs, check_program
from sitl.apps.sweep_case import one_thread
from sitl.faults.flights.fault_flight import FaultCase, FaultRecord, Stage, fly
from sitl.faults.injectors.base import Capabilities
from sitl.faults.report.html_page import write_page
from sitl.faults.report.scenario_result import Result, result_of
from sitl.faults.soak import SOAKS
from sitl.faults.table.all_scenarios import NAMED, PAIRS, ROWS, TABLE
from sitl.faults.table.scenario import Scenario
from sitl.runtime.worker_pool import worker_pool
from uav_recon.app.option_validation import readable, require_writable_file, require_writable_folder
from uav_recon.bench import result_file
from uav_recon.bench.machine_calibration import Calibration, calibrate
from uav_recon.bench.result_file import result_header
from uav_recon.errors import UserError

BOTH = "both"
FIRMWARE_OFFERS = {
    "px4": Capabilities.PROCESSES | Capabilities.LINE,
    "ardupilot": Capabilities.PROCESSES | Capabilities.LINE | Capabilities.STICKS,
}


@dataclass(frozen=True)
class FaultOptions:
    """Rows are flown with seeds seed0, seed0 + 1, ... and for each personality, and told in the order of the table. firmware: a
    real one in its place, always live.
    """

    rows: tuple[Scenario, ...]
    autopilots: tuple[str, ...]
    seeds: int
    jobs: int
    json: Path | None
    out: Path | None
    live: bool = False
    firmware: Path | None = None
    seed0: int = 0

    @staticmethod
    def parse(
        *, only: str | None = None, autopilot: str = BOTH, seeds: int = 3, jobs: int = 2, json: Path | None = None,
        out: Path | None = None, live: bool = False, firmware: Path | None = None, seed0: int = 0,
    ) -> FaultOptions:  # fmt: skip
        """Check the words of the command line. Raises UsageError with one line."""
        names = None if only is None else tuple(word.strip() for word in only.split(","))
        unknown = [name for name in names or () if name not in NAMED]
        if unknown:
            there_are = f"{', '.join(row.id for row in (*TABLE, *SOAKS))}, and pairs as {PAIRS[0].id}"
            raise UsageError(
                f"--only {only}: no row {', '.join(name or repr(name) for name in unknown)}; there are {there_are}"
            )
        if autopilot not in (*AUTOPILOTS, BOTH):
            raise UsageError(f"--autopilot {autopilot}: want one of {', '.join((*AUTOPILOTS, BOTH))}")
        if firmware is not None:
            check_program(firmware)
            if autopilot == BOTH:
                raise UsageError(f"--autopilot {BOTH}: with --firmware want {' or '.join(AUTOPILOTS)}, which it is")
        personalities, flown = AUTOPILOTS if autopilot == BOTH else (autopilot,), _flown(autopilot, live, firmware)
        wanted = TABLE if names is None else _in_order(names)
        rows = tuple(row for row in wanted if flown(row) or not (live or firmware))
        if not rows:
            how = "in real time" if firmware is None else f"with a real {autopilot}"
            raise UsageError(f"--only {only}: not flown {how}; {', '.join(r.id for r in TABLE if flown(r))} are")
        one_by_one = live or firmware is not None
        jobs = 1 if one_by_one else check_jobs(jobs)
        return FaultOptions(rows, personalities, seeds, jobs, json, out, one_by_one, firmware, seed0)

    def cases(self, row: Scenario, autopilot: str) -> list[FaultCase]:
        """The flights of a row; none for one that cannot be flown here."""
        if not _flown(autopilot, self.live, self.firmware)(row):
            return []
        numbers = range(self.seed0, self.seed0 + (self.seeds if self.live else self.seeds * row.times))
        folders = [None if self.out is None else self.out / f"{row.id}-{autopilot}-{number}" for number in numbers]
        return [
            FaultCase(row.id, autopilot, number, folder, self.live, self.firmware)
            for number, folder in zip(numbers, folders, strict=True)
        ]

    def groups(self) -> list[list[FaultCase]]:
        """All flights: those together that can be, seed by seed; in real time each is alone."""
        cases = [case for autopilot in self.autopilots for row in self.rows for case in self.cases(row, autopilot)]
        if self.live:
            return [[case] for case in cases]
        groups: dict[Stage, list[FaultCase]] = {}
        for case in sorted(cases, key=lambda case: (self.autopilots.index(case.autopilot), case.number)):
            groups.setdefault(case.stage, []).append(case)
        return list(groups.values())


def _in_order(names: Sequence[str]) -> tuple[Scenario, ...]:
    """The rows that are meant, in the order of the table; soaks and pairs behind it."""
    meant = {row.id for name in names for row in NAMED[name]}
    return tuple(row for row in ROWS.values() if row.id in meant)


def _flown(autopilot: str, live: bool, firmware: Path | None) -> Callable[[Scenario], bool]:
    """Which rows there are."""
    return lambda row: row.flown(live) if firmware is None else row.flown_by(FIRMWARE_OFFERS[autopilot])


def faults(options: FaultOptions) -> int:
    """Fly them; returns 1 if any row failed, else 0. Raises Failure."""
    console, results = Console(), list[Result]()
    groups = options.groups()
    with readable(f"--out {options.out}"):
        taken = [case.out for group in groups for case in group if case.out is not None and case.out.exists()]
    if taken:
        raise UsageError(f"--out {options.out}: holds flights already, {taken[0].name} for one")
    require_writable_file("--json", options.json)
    require_writable_folder("--out", options.out)
    one_thread()
    calibration = calibrate()
    with contextlib.closing(_fly_all(groups, options.jobs, console)) as records:
        for result in _results(options, records):
            results.append(result)
            console.print(_line(result), markup=False, highlight=False, soft_wrap=True)
            _save(options, results, calibration)
    flown = [r for r in results if r.passed is not None]
    bad = [r for r in flown if not r.passed]
    for said in sorted({r.firmware for r in flown if r.firmware}):
        console.print(f"firmware: {options.autopilots[0]} {said}", markup=False, highlight=False)
    console.print(f"{len(flown)} rows flown, {len(bad)} failed, {len(results) - len(flown)} not flown here")
    if not flown:
        raise UsageError("nothing was flown: none of these rows can be flown here")
    return 1 if bad else 0


def _fly_all(groups: list[list[FaultCase]], jobs: int, console: Console) -> Generator[FaultRecord, None, None]:
    """Records as they come, under a bar that tells how many there are yet to come; a flight that missed is told of at once."""
    columns = (
        TextColumn("flights"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with (
        Progress(*columns, console=console, disable=not console.is_terminal) as progress,
        worker_pool(jobs) as hands,
    ):
        task = progress.add_task("", total=sum(map(len, groups)))
        for future in as_completed([hands.submit(fly, group) for group in groups]):
            for record in future.result():
                if record.trace and record.case.out is not None:
                    record.case.out.mkdir(parents=True, exist_ok=True)
                    (record.case.out / "trace.txt").write_text(record.trace, encoding="utf-8")
                if not record.verdict.passed(ROWS[record.case.row], record.case.autopilot):
                    console.print(_missed(record), markup=False, highlight=False, soft_wrap=True)
                progress.advance(task)
                yield record


def _results(options: FaultOptions, records: Iterator[FaultRecord]) -> Iterator[Result]:
    """Of each row and personality, in order, as soon as its last flight and those of the rows before are over."""
    told: dict[FaultCase, FaultRecord] = {}
    for autopilot in options.autopilots:
        for row in options.rows:
            cases = options.cases(row, autopilot)
            while not told.keys() >= set(cases):
                record = next(records)
                told[record.case] = record
            firmware = next((told[case].firmware for case in cases if told[case].firmware), "")
            how = cases[0].how if cases else ""
            yield result_of(row, autopilot, [told[case].verdict for case in cases], firmware, options.seed0, how)


def _missed(record: FaultRecord) -> str:
    """What broke, and how to fly it again."""
    case = record.case
    result = result_of(ROWS[case.row], case.autopilot, [record.verdict], how=case.how)
    return f"missed: {', '.join((*result.broken(), *result.remarks))} ({result.again(case.number)})"


def _line(result: Result) -> str:
    head = f"{result.row.id:4} {result.autopilot:9} {result.row.hazard[:34]:34}"
    if result.passed is None:
        return f"{head} not flown: {result.row.why}"
    word = "pass" if result.passed else "FAIL"
    more = "" if not result.remarks else "  " + "; ".join(result.remarks)
    which = f"  seed {', '.join(map(str, result.missed))}" if result.missed else ""
    return f"{head} {result.kept:2}/{result.seeds:<2} {word}  {result.sentence()}{more}{which}"


def summary(results: Sequence[Result]) -> dict[str, int]:
    """Return the counts of a campaign; a scenario counts once for each simulated autopilot that flew it."""
    flown = [result for result in results if result.passed is not None]
    return {
        "scenarios": len(flown),
        "scenarios_failed": sum(not result.passed for result in flown),
        "flights": sum(result.seeds for result in flown),
        "flights_failed": sum(len(result.missed) for result in flown),
        "contacts": sum(result.contacts for result in flown),
    }


def _save(options: FaultOptions, results: list[Result], calibration: Calibration) -> None:
    try:
        if options.json is not None:
            rows = [result.tree() for result in results]
            result_file.save(options.json, {"summary": summary(results), "rows": rows}, result_header(calibration))
        if options.out is not None:
            options.out.mkdir(parents=True, exist_ok=True)
            write_page(options.out / "faults.html", results)
    except OSError as error:
        raise UserError(f"{error.filename}: cannot be written ({error.strerror})") from None
