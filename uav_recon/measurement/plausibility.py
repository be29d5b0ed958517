"""Values of a result that cannot be: more views than the budget, a recall after the landing.

A result is a tree of dictionaries and lists as in a JSON file; see result_file. A flight has its figures in ``report``
(`sim`) or in an element of ``flights`` (`sweep`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

Tree = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Bounded:
    """A value with its path of keys and the largest value that can be.

    None: unknown, which is always possible.
    """

    key: str
    value: float | None
    highest: float | None
    because: str

    @property
    def possible(self) -> bool:
        """True if the value lies between 0 and `highest`, or one of both is unknown."""
        return self.value is None or (self.value >= 0.0 and (self.highest is None or self.value <= self.highest))


def impossible_value(tree: Tree) -> str:
    """Return the first impossible value, `KEY: VALUE; allowed RANGE (REASON)`; '' without one.

    Raises KeyError for a flight without its figures or its budget of views.
    """
    for bounded in _bounded(tree):
        if not bounded.possible:
            highest = "" if bounded.highest is None else f"{bounded.highest:g}"
            return f"{bounded.key}: {bounded.value:g}; allowed 0 to {highest} ({bounded.because})"
    return ""


def _bounded(tree: Tree) -> Iterator[Bounded]:
    if isinstance(report := tree.get("report"), Mapping):
        yield Bounded("report/views", report["views"], tree["view_budget"], "the budget of views")
        for recall, time_s in report["time_to_recall_s"].items():
            yield Bounded(f"report/time_to_recall_s/{recall}", time_s, report["flight_time_s"], "the end of the flight, s")
    for number, flight in enumerate(tree.get("flights", ())):
        yield Bounded(f"flights/{number}/views", flight["views"], flight["case"]["views"], "the budget of views")
        yield Bounded(f"flights/{number}/recall_90_s", flight["recall_90_s"], flight["flight_s"], "the end of the flight, s")
