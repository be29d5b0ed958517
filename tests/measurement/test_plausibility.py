"""Results with a value that cannot be, and results at the edge of what can."""

from __future__ import annotations

from typing import Any

import pytest

from uav_recon.measurement.plausibility import impossible_value


def mission(views: int = 60, recall_s: float | None = 80.0) -> dict[str, Any]:
    report = {"views": views, "time_to_recall_s": {"0.90": 70.0, "0.95": recall_s}, "flight_time_s": 183.0}
    return {"view_budget": 60, "report": report}


def sweep(views: int = 40, recall_s: float | None = 80.0) -> dict[str, Any]:
    first = {"case": {"views": 40}, "views": 40, "recall_90_s": None, "flight_s": 150.0}
    return {"flights": [first, {**first, "views": views, "recall_90_s": recall_s}]}


@pytest.mark.parametrize("tree", [{}, mission(), mission(0), mission(recall_s=183.0), mission(recall_s=None), sweep()])
def test_what_can_be_is_no_fault(tree: dict[str, Any]) -> None:
    assert impossible_value(tree) == ""


def test_a_flight_with_the_default_budget_or_an_error_has_no_bound() -> None:
    unknown = {"case": {"views": None}, "views": 120, "recall_90_s": None, "flight_s": None}
    assert impossible_value({"flights": [unknown]}) == ""
    assert impossible_value({"flights": [{**unknown, "views": None}]}) == ""


@pytest.mark.parametrize(
    ("tree", "said"),
    [
        (mission(views=61), "report/views: 61; allowed 0 to 60 (the budget of views)"),
        (mission(views=-1), "report/views: -1; allowed 0 to 60 (the budget of views)"),
        (mission(recall_s=274.0), "report/time_to_recall_s/0.95: 274; allowed 0 to 183 (the end of the flight, s)"),
        (sweep(views=41), "flights/1/views: 41; allowed 0 to 40 (the budget of views)"),
        (sweep(recall_s=150.1), "flights/1/recall_90_s: 150.1; allowed 0 to 150 (the end of the flight, s)"),
    ],
)
def test_what_cannot_be_is_named_with_its_range(tree: dict[str, Any], said: str) -> None:
    assert impossible_value(tree) == said
