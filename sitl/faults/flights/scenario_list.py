"""`uav-recon faults --list`: the scenarios, with the fault that each injects and its limits."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from sitl.apps.scene_list import PIPE_WIDTH
from sitl.faults.flights.campaign import scenarios_named
from sitl.faults.soak import SOAKS
from sitl.faults.table.all_scenarios import PAIRS, TABLE
from sitl.faults.table.scenario import Limit, Scenario


def print_scenarios(only: str | None = None) -> int:
    """Print a table of the scenarios, or of those named; returns the exit code.

    Raises UsageError for an unknown one.
    """
    scenarios = (*TABLE, *SOAKS) if only is None else scenarios_named(only)
    console = Console()
    if not console.is_terminal:
        console.width = PIPE_WIDTH
    table = Table("id", "hazard", "injected fault", "limits", "flown in", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for scenario in scenarios:
        limits = "\n".join(limit_text(limit) for limit in scenario.limits) or "general limits only"
        table.add_row(scenario.id, scenario.hazard, scenario.injection, limits, clock_of(scenario))
    console.print(table, highlight=False, markup=False)
    if only is None:
        console.print(
            f"{PAIRS[0].id} and {len(PAIRS) - 1} other pairs: two faults in one flight; --only G10 flies all of them. "
            "G9: the soak test.", highlight=False, markup=False,
        )  # fmt: skip
    return 0


def clock_of(scenario: Scenario) -> str:
    """Return where a scenario can be flown: lockstep, real time, or both."""
    clocks = [word for word, live in (("lockstep", False), ("real time", True)) if scenario.flown(live)]
    return ", ".join(clocks) or "not flown"


def limit_text(limit: Limit) -> str:
    """Return a limit as `name <= value unit`.

    A different value for ArduPilot is appended.
    """
    text = f"{limit.name} {'>=' if limit.at_least else '<='} {limit.limit:g} {limit.unit}".rstrip()
    return text if limit.ardupilot is None else f"{text} (ArduPilot {limit.ardupilot:g})"
