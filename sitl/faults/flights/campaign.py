"""`uav-recon faults`: fly the scenarios, print their values and limits, and write a report.

One line is printed for each scenario.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from sitl.apps.flight_folder import check_program
from sitl.apps.kernel_compilation import compile_ahead, flight_jobs
from sitl.apps.sim_options import camera_error_scale
from sitl.apps.sweep_case import one_thread
from sitl.faults.flights.fault_flight import FaultCase, FaultRecord, Stage, fly
from sitl.faults.flights.fault_options import FaultOptions
from sitl.faults.injectors.base import Capabilities
from sitl.faults.report.campaign_page import write_page
from sitl.faults.report.scenario_result import Result, result_of
from sitl.faults.table.all_scenarios import NAMED, PAIRS, SCENARIOS, TABLE
from sitl.faults.table.scenario import Scenario
from sitl.runtime.worker_pool import worker_pool
from uav_recon.app.option_validation import UsageError, readable, require_writable_file, require_writable_folder
from uav_recon.errors import UserError
from uav_recon.measurement import result_file
from uav_recon.measurement.machine_speed import MachineSpeed, measure_machine_speed
from uav_recon.measurement.result_file import result_header

FIRMWARE_OFFERS = {
    "px4": Capabilities.PROCESSES | Capabilities.SERIAL_LINE,
    "ardupilot": Capabilities.PROCESSES | Capabilities.SERIAL_LINE | Capabilities.RC_TRANSMITTER,
}


@dataclass(frozen=True)
class Campaign:
    """The flights of the options.

    scenarios: in the order of the table. They are flown for each autopilot with seeds seed0, seed0 + 1, ...
    """

    options: FaultOptions
    scenarios: tuple[Scenario, ...]

    @staticmethod
    def of(options: FaultOptions) -> Campaign:
        """Find the scenarios and check the firmware. Raises UsageError with one line."""
        check_program(options.firmware)
        can_fly = _can_fly(options.autopilot, options.real_time, options.firmware)
        wanted = TABLE if options.only is None else scenarios_named(options.only)
        scenarios = tuple(scenario for scenario in wanted if can_fly(scenario) or not options.live)
        if not scenarios:
            how = "in real time" if options.firmware is None else f"with a real {options.autopilot} firmware"
            names = ", ".join(scenario.id for scenario in TABLE if can_fly(scenario))
            raise UsageError(f"--only {options.only}: cannot run {how}; want one of {names}")
        return Campaign(options, scenarios)

    def cases(self, scenario: Scenario, autopilot: str) -> list[FaultCase]:
        """Return the flights of a scenario; none for one that cannot be flown here."""
        options = self.options
        if not _can_fly(autopilot, options.live, options.firmware)(scenario):
            return []
        numbers = range(options.seed0, options.seed0 + (options.seeds if options.live else options.seeds * scenario.times))
        folders = [None if options.out is None else options.out / f"{scenario.id}-{autopilot}-{number}" for number in numbers]
        scale = camera_error_scale(options.camera_errors)
        return [
            FaultCase(scenario.id, autopilot, number, folder, options.live, options.firmware, scale)
            for number, folder in zip(numbers, folders, strict=True)
        ]

    def groups(self) -> list[list[FaultCase]]:
        """Return all flights, seed by seed, grouped where flights share their start.

        In real time each flight is a group of its own.
        """
        autopilots = self.options.autopilots
        cases = [case for autopilot in autopilots for one in self.scenarios for case in self.cases(one, autopilot)]
        if self.options.live:
            return [[case] for case in cases]
        groups: dict[Stage, list[FaultCase]] = {}
        for case in sorted(cases, key=lambda case: (autopilots.index(case.autopilot), case.number)):
            groups.setdefault(case.stage, []).append(case)
        return list(groups.values())


def scenarios_named(only: str) -> tuple[Scenario, ...]:
    """Return the scenarios of a comma-separated list, in the order of the table.

    Raises UsageError for an unknown one.
    """
    names = tuple(word.strip() for word in only.split(","))
    unknown = [name for name in names if name not in NAMED]
    if unknown:
        known = f"`uav-recon faults --list` shows {TABLE[0].id} to {TABLE[-1].id}, and pairs such as {PAIRS[0].id}"
        raise UsageError(f"--only {only}: no scenario {', '.join(name or repr(name) for name in unknown)}; {known}")
    meant = {scenario.id for name in names for scenario in NAMED[name]}
    return tuple(scenario for scenario in SCENARIOS.values() if scenario.id in meant)


def _can_fly(autopilot: str, live: bool, firmware: Path | None) -> Callable[[Scenario], bool]:
    """Return the check that a scenario can be flown with these options."""
    return lambda one: one.flown(live) if firmware is None else one.flown_by(FIRMWARE_OFFERS[autopilot])


def faults(options: FaultOptions) -> int:
    """Fly the scenarios; returns 1 if any failed, else 0. Raises UserError."""
    console, results = Console(), list[Result]()
    campaign = Campaign.of(options)
    groups = campaign.groups()
    with readable(f"--out {options.out}"):
        taken = [case.out for group in groups for case in group if case.out is not None and case.out.exists()]
    if taken:
        raise UsageError(f"--out {options.out}: already contains flights, e.g. {taken[0].name}")
    require_writable_file("--json", options.json)
    require_writable_folder("--out", options.out)
    compile_ahead(flight_jobs(neural=False), console)
    one_thread()
    machine_speed = measure_machine_speed()
    with contextlib.closing(_fly_all(groups, 1 if options.live else options.jobs, console)) as records:
        for result in _results(campaign, records):
            results.append(result)
            console.print(_line(result), markup=False, highlight=False, soft_wrap=True)
            _save(options, results, machine_speed)
    flown = [r for r in results if r.passed is not None]
    bad = [r for r in flown if not r.passed]
    for version in sorted({r.firmware for r in flown if r.firmware}):
        console.print(f"firmware: {options.autopilots[0]} {version}", markup=False, highlight=False)
    passed, skipped = len(flown) - len(bad), len(results) - len(flown)
    console.print(f"scenarios: {passed} passed, {len(bad)} failed, {skipped} not flown", highlight=False)
    if not flown:
        raise UsageError(_why_nothing_was_flown(campaign.scenarios))
    return 1 if bad else 0


def _why_nothing_was_flown(scenarios: Sequence[Scenario]) -> str:
    """Return the reason why none of these scenarios was flown in lockstep.

    The text names the option that flies those that can be flown.
    """
    live = [scenario.id for scenario in scenarios if scenario.flown(live=True)]
    if live:
        return f"{', '.join(live)} cannot run in lockstep. Run {'it' if len(live) == 1 else 'them'} with --real-time."
    return f"no flight: {', '.join(scenario.id for scenario in scenarios)} cannot be flown ({scenarios[0].why})"


def _fly_all(groups: list[list[FaultCase]], jobs: int, console: Console) -> Generator[FaultRecord, None, None]:
    """Yield records as they come, with a progress bar.

    A flight that missed a limit is printed at once.
    """
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
                if not record.verdict.passed(SCENARIOS[record.case.scenario], record.case.autopilot):
                    console.print(_missed(record), markup=False, highlight=False, soft_wrap=True)
                progress.advance(task)
                yield record


def _results(campaign: Campaign, records: Iterator[FaultRecord]) -> Iterator[Result]:
    """Yield the result of each scenario and autopilot, in order.

    Each comes as soon as its flights and those of the earlier ones are over.
    """
    flown: dict[FaultCase, FaultRecord] = {}
    for autopilot in campaign.options.autopilots:
        for scenario in campaign.scenarios:
            cases = campaign.cases(scenario, autopilot)
            while not flown.keys() >= set(cases):
                record = next(records)
                flown[record.case] = record
            firmware = next((flown[case].firmware for case in cases if flown[case].firmware), "")
            how = cases[0].how if cases else ""
            yield result_of(scenario, autopilot, [flown[case].verdict for case in cases], firmware, campaign.options.seed0, how)


def _missed(record: FaultRecord) -> str:
    """Return what a flight missed, and the options that repeat it."""
    case = record.case
    result = result_of(SCENARIOS[case.scenario], case.autopilot, [record.verdict], how=case.how)
    return f"missed: {', '.join((*result.broken(), *result.remarks))} (repeat: {result.again(case.number)})"


def _line(result: Result) -> str:
    head = f"{result.scenario.id:4} {result.autopilot:9} {result.scenario.hazard[:34]:34}"
    if result.passed is None:
        return f"{head} not flown: {result.scenario.why}"
    verdict = "pass" if result.passed else "FAIL"
    more = "" if not result.remarks else "  " + "; ".join(result.remarks)
    which = f"  seed {', '.join(map(str, result.missed))}" if result.missed else ""
    return f"{head} {result.kept:2}/{result.seeds:<2} {verdict}  {result.sentence()}{more}{which}"


def summary(results: Sequence[Result]) -> dict[str, int]:
    """Return the counts of a campaign.

    A scenario counts once for each simulated autopilot that flew it.
    """
    flown = [result for result in results if result.passed is not None]
    return {
        "scenarios": len(flown),
        "scenarios_failed": sum(not result.passed for result in flown),
        "flights": sum(result.seeds for result in flown),
        "flights_failed": sum(len(result.missed) for result in flown),
        "contacts": sum(result.contacts for result in flown),
    }


def _save(options: FaultOptions, results: list[Result], machine_speed: MachineSpeed) -> None:
    try:
        if options.json is not None:
            scenarios = [result.tree() for result in results]
            result_file.save(options.json, {"summary": summary(results), "scenarios": scenarios}, result_header(machine_speed))
        if options.out is not None:
            options.out.mkdir(parents=True, exist_ok=True)
            write_page(options.out / "faults.html", results)
    except OSError as error:
        raise UserError(f"{error.filename}: cannot be written ({error.strerror})") from None
