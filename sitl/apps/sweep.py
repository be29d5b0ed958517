"""`uav-recon sweep`: many flights in quick lockstep, with a results file to resume from."""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from sitl.apps.kernel_compilation import compile_ahead, flight_jobs
from sitl.apps.sim_options import camera_error_scale
from sitl.apps.sweep_case import Case, Record, fly_case, one_thread
from sitl.apps.sweep_options import BUILT_IN, SweepOptions
from sitl.runtime.worker_pool import worker_pool
from sitl.scene.scene import is_generated
from sitl.scene.scene_kinds import KINDS
from uav_recon import json_codec
from uav_recon.app.option_validation import require_writable_file
from uav_recon.errors import EXIT_USAGE, UserError
from uav_recon.measurement import host_info, result_file
from uav_recon.measurement.machine_speed import MachineSpeed, measure_machine_speed
from uav_recon.measurement.result_file import result_header

BAD_SHOWN = 20
MEDIANS = ("flight_s", "path_m", "views", "explored", "recall", "recall_90_s", "times_real")


def cases(options: SweepOptions) -> Iterator[Case]:
    """Yield all flights, in order.

    They iterate over scenes, then radii, variants, mounts and autopilots, and start again with the next seed.
    """
    round_of = list(
        itertools.product(options.autopilots, options.mounts, options.variant_names, options.radii_m, options.scene_names)
    )
    for number in range(options.flights):
        seed, place = options.seed0 + number // len(round_of), round_of[number % len(round_of)]
        autopilot, mount, variant, radius_m, name = place
        scene = f"{name}:{seed}" if name in KINDS else None if name == BUILT_IN else name
        yield Case(
            scene, seed, radius_m, variant, mount, options.camera, options.views, autopilot,
            camera_error_scale(options.camera_errors), options.pose, options.range_up_deg, options.flow,
        )  # fmt: skip


def sweep(options: SweepOptions) -> int:
    """Fly the cases that the results file lacks; return the exit code. Raises UserError.

    Exit code 1: a flight had a contact or an error; otherwise 0.
    """
    console = Console()
    require_writable_file("--json", options.json)
    records = _load(options.json)
    known = {record.case for record in records}
    todo = [case for case in cases(options) if case not in known]
    compile_ahead(flight_jobs(options.variant_names, neural=False), console)
    columns = (TextColumn("flights"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task("", total=len(todo))
        one_thread()
        machine_speed, commit = measure_machine_speed(), host_info.commit()
        for record in _fly_all(todo, options.truth, options.jobs):
            records.append(dataclasses.replace(record, commit=commit))
            _save(options.json, records, machine_speed)
            progress.console.print(_line(record), markup=False, highlight=False, soft_wrap=True)
            progress.advance(task)
    wanted = set(cases(options))
    records = [record for record in records if record.case in wanted]
    return _conclude(records, console)


def _fly_all(todo: list[Case], truth: bool, jobs: int) -> Iterator[Record]:
    """Yield records in the order of completion.

    If a process dies, each flight in progress is repeated alone, to find the one that caused it.
    """
    waiting = list(reversed(todo))
    while waiting:
        suspects: list[Case] = []
        with worker_pool(jobs) as hands:
            flying: dict[Future[Record], Case] = {}
            while flying or (waiting and not suspects):
                while waiting and not suspects and len(flying) < jobs:
                    case = waiting.pop()
                    flying[hands.submit(fly_case, case, truth)] = case
                for future in wait(flying, return_when=FIRST_COMPLETED).done:
                    case = flying.pop(future)
                    try:
                        yield future.result()
                    except BrokenProcessPool:
                        suspects.append(case)
        if jobs == 1:
            yield from (Record(case, error="the process died") for case in suspects)
        else:
            for case in suspects:
                yield from _fly_all([case], truth, 1)


def _load(path: Path | None) -> list[Record]:
    if path is None:
        return []
    try:
        return [json_codec.from_tree(Record, tree) for tree in json.loads(path.read_text(encoding="utf-8"))["flights"]]
    except FileNotFoundError:
        return []
    except RecursionError:
        raise UserError(f"--json {path}: not a results file of `uav-recon sweep` (nested too deeply)", EXIT_USAGE) from None
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UserError(f"--json {path}: not a results file of `uav-recon sweep` ({error})", EXIT_USAGE) from None


def _save(path: Path | None, records: list[Record], machine_speed: MachineSpeed) -> None:
    if path is not None:
        result_file.save(path, {"summary": summary(records), "flights": records}, result_header(machine_speed))


def summary(records: list[Record]) -> dict[str, object]:
    """Return a summary of all flights.

    It holds counts, the smallest clearance and explored share, and the commits that flew them.
    """
    clearances = [record.min_clearance_m for record in records if record.min_clearance_m is not None]
    explored = [record.explored for record in records if record.explored is not None]
    return {
        "flights": len(records),
        "completed": sum(record.outcome == "completed" for record in records),
        "completed_early": sum(record.outcome == "completed" and bool(record.ended_early) for record in records),
        "not_completed": sum(record.outcome != "completed" for record in records),
        "contacts": sum(record.contacts or 0 for record in records),
        "errors": sum(bool(record.error) for record in records),
        "max_odometry_ate_cm": max((r.odometry_ate_cm for r in records if r.odometry_ate_cm is not None), default=None),
        "min_clearance_m": min(clearances, default=None),
        "min_explored": min(explored, default=None),
        "median_flight_s": _median([record.flight_s for record in records]),
        "commits": sorted({record.commit for record in records}),
    }


def _median(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None


def _number(value: float | None, digits: int, width: int) -> str:
    return f"{'-' if value is None else format(value, f'.{digits}f'):>{width}}"


def _line(record: Record) -> str:
    case = record.case
    craft = f"r {case.radius_m:.2f} {case.variant:9} {case.mount:8} {case.autopilot:9}"
    head = f"{case.scene or BUILT_IN:14} seed {case.seed:4} {craft}"
    if record.error:
        return f"{head} ERROR {record.error}"
    return (
        f"{head} flight {_number(record.flight_s, 0, 4)} s  path {_number(record.path_m, 1, 6)} m  views {record.views:3}  "
        f"explored {_number(record.explored, 3, 5)}  recall {_number(record.recall, 3, 5)}  "
        f"clearance {_number(record.min_clearance_m, 3, 6)} m  "
        f"contacts {record.contacts}  x{_number(record.times_real, 1, 5)}  {record.outcome}: {record.stop_reason}"
    )


def _conclude(records: list[Record], console: Console) -> int:
    """Print two lines per group of flights (all but the seed equal), a command per bad flight.

    Returns the exit code.
    """

    def say(text: str) -> None:
        console.print(text, markup=False, highlight=False, soft_wrap=True)

    groups: dict[tuple[str, float, str, str, str], list[Record]] = {}
    for record in records:
        scene = record.case.scene or BUILT_IN
        kind = scene.partition(":")[0] if is_generated(scene) else Path(scene).name
        case = record.case
        groups.setdefault((kind, case.radius_m, case.variant, case.mount, case.autopilot), []).append(record)
    for (kind, radius_m, variant, mount, autopilot), some in sorted(groups.items()):
        completed, broken = sum(r.outcome == "completed" for r in some), sum(bool(r.error) for r in some)
        early = sum(r.outcome == "completed" and bool(r.ended_early) for r in some)
        contacts = sum(r.contacts or 0 for r in some)
        clearances = [r.min_clearance_m for r in some if r.min_clearance_m is not None]
        say(
            f"{kind}, radius {radius_m:.2f} m, {variant}, {mount}, {autopilot}: {len(some)} flights, {completed} completed "
            f"({early} before everything was seen), {contacts} contacts, {broken} errors, "
            f"min clearance {_number(min(clearances, default=None), 3, 0)} m"
        )
        flight_s, path_m, views, explored, recall, recall_s, times = (_middle(some, name) for name in MEDIANS)
        say(
            f"    medians: {flight_s} s, {path_m} m, {views} views, explored {explored}, recall {recall}, "
            f"0.90 after {recall_s} s, {times} x real time"
        )
    bad = [record for record in records if record.bad]
    for record in bad[:BAD_SHOWN]:
        what = record.error or f"{record.contacts} contacts, clearance {_number(record.min_clearance_m, 3, 0)} m"
        say(f"{what}: {record.case.command()}")
    if len(bad) > BAD_SHOWN:
        say(f"... and {len(bad) - BAD_SHOWN} more")
    return 1 if bad else 0


def _middle(records: list[Record], name: str) -> str:
    known = [value for value in (getattr(record, name) for record in records) if value is not None]
    return f"{np.median(known):.3g}" if known else "-"
