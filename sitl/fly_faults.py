"""`uav-recon faults`: each hazard's scenario a line a row with the figure beside its bar, and a report."""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from sitl.faults.page import write_page
from sitl.faults.result import Result, result_of
from sitl.faults.row import Row
from sitl.faults.table import ROWS, TABLE
from sitl.fly_case import one_thread
from sitl.fly_fault import FaultCase, FaultRecord, fly_fault
from sitl.fly_options import AUTOPILOTS, UsageError
from uav_recon import run

BOTH = "both"


@dataclass(frozen=True)
class FaultOptions:
    """Rows are flown in the order of the table, each with seeds 0, 1, ... and for each personality."""

    rows: tuple[Row, ...]
    autopilots: tuple[str, ...]
    seeds: int
    jobs: int
    json: Path | None
    out: Path | None
    live: bool = False

    @staticmethod
    def parse(
        *, only: str | None = None, autopilot: str = BOTH, seeds: int = 3, jobs: int = 2, json: Path | None = None,
        out: Path | None = None, live: bool = False,
    ) -> FaultOptions:  # fmt: skip
        """Check the words of the command line. Raises UsageError with one line."""
        names = tuple(ROWS) if only is None else tuple(word.strip() for word in only.split(","))
        unknown = [name for name in names if name not in ROWS]
        if unknown:
            raise UsageError(f"--only {only}: no row {', '.join(unknown)}; there are {', '.join(ROWS)}")
        if autopilot not in (*AUTOPILOTS, BOTH):
            raise UsageError(f"--autopilot {autopilot}: want one of {', '.join((*AUTOPILOTS, BOTH))}")
        personalities = AUTOPILOTS if autopilot == BOTH else (autopilot,)
        rows = tuple(row for row in TABLE if row.id in names and (row.flown(live) or not live))
        if not rows:
            raise UsageError(f"--only {only}: not flown in real time; {', '.join(r.id for r in TABLE if r.flown(live))} are")
        return FaultOptions(rows, personalities, seeds, 1 if live else jobs, json, out, live)

    def cases(self, row: Row, autopilot: str) -> list[FaultCase]:
        """The flights of a row; none for one that cannot be flown here."""
        if not row.flown(self.live):
            return []
        folders = [None if self.out is None else self.out / f"{row.id}-{autopilot}-{seed}" for seed in range(self.seeds)]
        return [FaultCase(row.id, autopilot, seed, folder, self.live) for seed, folder in enumerate(folders)]


def faults(options: FaultOptions) -> int:
    """Fly them; returns 1 if any row failed, else 0. Raises run.Failure."""
    console, results = Console(), []
    one_thread()
    with ProcessPoolExecutor(options.jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        for result in _results(options, pool):
            results.append(result)
            console.print(_line(result), markup=False, highlight=False, soft_wrap=True)
            _save(options, results)
    flown = [r for r in results if r.passed is not None]
    bad = [r for r in flown if not r.passed]
    console.print(f"{len(flown)} rows flown, {len(bad)} failed, {len(results) - len(flown)} not flown here")
    return 1 if bad else 0


def _results(options: FaultOptions, pool: ProcessPoolExecutor) -> Iterator[Result]:
    pending = []
    for autopilot in options.autopilots:
        for row in options.rows:
            pending.append((row, autopilot, [pool.submit(fly_fault, case) for case in options.cases(row, autopilot)]))
    for row, autopilot, futures in pending:
        records: list[FaultRecord] = [future.result() for future in futures]
        for record in records:
            if record.trace and record.case.out is not None:
                record.case.out.mkdir(parents=True, exist_ok=True)
                (record.case.out / "trace.txt").write_text(record.trace, encoding="utf-8")
        yield result_of(row, autopilot, [record.verdict for record in records])


def _line(result: Result) -> str:
    head = f"{result.row.id:4} {result.autopilot:9} {result.row.hazard[:34]:34}"
    if result.passed is None:
        return f"{head} not flown: {result.row.why}"
    word = "pass" if result.passed else "FAIL"
    more = "" if not result.remarks else "  " + "; ".join(result.remarks)
    return f"{head} {result.kept:2}/{result.seeds:<2} {word}  {result.sentence()}{more}"


def _save(options: FaultOptions, results: list[Result]) -> None:
    try:
        if options.json is not None:
            options.json.write_text(json.dumps({"rows": [r.tree() for r in results]}, indent=1), encoding="utf-8")
        if options.out is not None:
            options.out.mkdir(parents=True, exist_ok=True)
            write_page(options.out / "faults.html", results)
    except OSError as error:
        raise run.Failure(f"{error.filename}: cannot be written ({error.strerror})") from None
