"""Result of a scenario over all its flights.

It holds the worst value for each limit, and the violations of the general limits.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from sitl.faults.table.scenario import Limit, Scenario, ScenarioVerdict

REAL_FIRMWARE = "T1"
CONTACT = "contact"  # first word of the message of invariants.violations() for a contact


@dataclass(frozen=True)
class Result:
    """Result of a scenario with one autopilot.

    passed: None if it was not flown.
    worst: worst value over the flights for each limit.
    missed: numbers of the flights that did not pass.
    remarks: violations of the general limits.
    firmware: version of a real firmware, "" for none.
    how: options with which it was flown, "" for lockstep.
    contacts: number of flights that touched something.
    """

    scenario: Scenario
    autopilot: str
    seeds: int
    missed: tuple[int, ...]
    passed: bool | None
    worst: tuple[float, ...]
    remarks: tuple[str, ...]
    firmware: str = ""
    how: str = ""
    contacts: int = 0

    @property
    def kept(self) -> int:
        """Number of flights that passed."""
        return self.seeds - len(self.missed)

    @property
    def figures(self) -> list[tuple[Limit, float]]:
        """Limits, each with its worst value; empty if nothing was flown."""
        return list(zip(self.scenario.limits, self.worst, strict=True)) if self.seeds else []

    def again(self, number: int) -> str:
        """Return the options that repeat one of its flights."""
        return f"--only {self.scenario.id} --autopilot {self.autopilot} {self.how} --seeds 1 --seed0 {number}".replace(
            "  ", " "
        )

    def headline(self) -> tuple[Limit, float] | None:
        """Return the limit that is used up most, and its value."""
        if not self.figures:
            return None
        return max(self.figures, key=lambda pair: pair[0].badness(pair[1], self.autopilot))

    def sentence(self) -> str:
        """Return the violated limits with their values; the tightest one if none is violated."""
        head = self.headline()
        return ", ".join(self.broken() or ([self._words(*head)] if head else []))

    def broken(self) -> list[str]:
        """Return a text for each violated limit."""
        return [self._words(limit, figure) for limit, figure in self.figures if not limit.holds(figure, self.autopilot)]

    def used(self) -> list[tuple[str, float]]:
        """Return, for each limit, its text and the share of it that is used up.

        A share above 1 is a violation; infinity means that the awaited event never came.
        """
        return [(self._words(limit, figure), limit.badness(figure, self.autopilot)) for limit, figure in self.figures]

    def _words(self, limit: Limit, figure: float) -> str:
        said = "never" if math.isinf(figure) else "-" if math.isnan(figure) else f"{figure:.2f}"
        sign = ">=" if limit.at_least else "<="
        return f"{limit.name} {said} {sign} {limit.limit_of(self.autopilot):g} {limit.unit}".rstrip()

    def tree(self) -> dict[str, object]:
        """Return the result for JSON.

        A value that is null never came, or could not be measured.
        """
        head = self.headline()
        return {
            "id": self.scenario.id,
            "tier": REAL_FIRMWARE if self.firmware else self.scenario.tier,
            "autopilot": self.autopilot,
            "firmware": self.firmware,
            "seeds": self.seeds,
            "passed": self.passed,
            "missed": list(self.missed),
            "contacts": self.contacts,
            "figure": _number(head[1]) if head else None,
            "limit": head[0].limit_of(self.autopilot) if head else None,
            "unit": head[0].unit if head else "",
            "measure": head[0].name if head else "",
            "limits": [
                {
                    "measure": b.name,
                    "figure": _number(f),
                    "limit": b.limit_of(self.autopilot),
                    "unit": b.unit,
                    "at_least": b.at_least,
                }
                for b, f in self.figures
            ],
            "remarks": list(self.remarks),
            "why": self.scenario.why,
        }


def result_of(
    scenario: Scenario, autopilot: str, verdicts: Sequence[ScenarioVerdict], firmware: str = "", first: int = 0, how: str = ""
) -> Result:
    """Return the result of a scenario: the worst values of all its flights.

    first: number of the first flight. Without verdicts the scenario was not flown.
    """
    if not verdicts:
        return Result(scenario, autopilot, 0, (), None, (), ())
    worst = []
    for k, limit in enumerate(scenario.limits):
        worst.append(max((v.figures[k] for v in verdicts), key=lambda figure: limit.badness(figure, autopilot)))
    missed = tuple(n for n, verdict in enumerate(verdicts, first) if not verdict.passed(scenario, autopilot))
    said = Counter(words for verdict in verdicts for words in verdict.broken)
    contacts = sum(any(words.startswith(CONTACT) for words in verdict.broken) for verdict in verdicts)
    remarks = tuple(words if count == 1 else f"{words} ({count} times)" for words, count in said.items())
    return Result(scenario, autopilot, len(verdicts), missed, not missed, tuple(worst), remarks, firmware, how, contacts)


def _number(value: float) -> float | None:
    return round(value, 4) if math.isfinite(value) else None
