"""Plot of recall and views over flight time, with the planning mode in the background."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from uav_recon.recording.flight_log import Timeline
from uav_recon.recording.plots import BLUE, INK, ORANGE, SOFT, new_figure, save, style
from uav_recon.recording.report import Report

_MODES = (("explore", "#dbeafe", "explore"), ("merged", "#ffedd5", "explore + reconstruct"), ("", "#e4e7eb", "nothing left"))


def recall_over_time(picture: Path, timeline: Timeline, report: Report) -> None:
    """Plot recall within 5 cm and views since the take-off command.

    Marks the times at which recall reached a limit; the planning modes are shaded.
    """
    start_s = timeline.took_off_s() or timeline.start_s()
    curve = report.recall_over_time or ()
    time_s = np.array([point[0] for point in curve])
    recall = 100.0 * np.array([point[2] for point in curve])
    end_s = max(float(time_s.max(initial=1.0)), report.last_view_s or 0.0)
    figure = new_figure(8.0, 4.0)
    axes = figure.add_subplot()
    style(axes, "since the order to take off, s", "recall within 5 cm, %", "Recall over flight time")
    axes.set_xlim(0.0, 1.02 * end_s)
    axes.set_ylim(0.0, 100.0)
    axes.yaxis.label.set_color(BLUE)
    _shade_modes(axes, timeline, start_s, end_s)
    _draw_views(axes, timeline, start_s, end_s)
    axes.plot(time_s, recall, color=BLUE, lw=2.2, marker="o", ms=3.5, mec="white", mew=0.6, label="recall in flight")
    if report.quality is not None and report.quality.recall_5cm is not None:
        final = 100.0 * report.quality.recall_5cm
        axes.axhline(final, color=BLUE, lw=1.2, ls=(0, (2, 2)), label=f"finished model: {final:.1f} %")
    reached = {mark: instant_s for mark, instant_s in report.time_to_recall_s.items() if instant_s is not None}
    for instant_s in sorted(set(reached.values())):
        marks = " and ".join(f"{100.0 * float(mark):.0f} %" for mark in reached if reached[mark] == instant_s)
        _draw_mark(axes, f"{marks} reached at {instant_s:.0f} s", instant_s, float(np.interp(instant_s, time_s, recall)))
    figure.legend(loc="outside lower center", ncols=6, frameon=False, fontsize=8.5, columnspacing=1.4, handletextpad=0.5)
    save(figure, picture)


def _shade_modes(axes: Any, timeline: Timeline, start_s: float, end_s: float) -> None:
    """Shade the mode from each plan to the next; the last one ends with the last view."""
    last_s = timeline.last_view_s()
    stop_s = end_s if last_s is None else last_s
    begins = [plan.stamp_s - start_s for plan in timeline.plans if plan.stamp_s - start_s < stop_s]
    named: set[str] = set()
    for plan, begin_s, next_s in zip(timeline.plans, begins, [*begins, stop_s][1:], strict=False):
        _, shade, name = next(row for row in _MODES if row[0] == plan.mode)
        label = None if name in named else name
        axes.axvspan(begin_s, min(next_s, stop_s), color=shade, lw=0, zorder=-2, label=label)
        named.add(name)
    if last_s is not None:
        axes.axvline(last_s, color=SOFT, lw=1.2, ls=":", label="last view")


def _draw_views(axes: Any, timeline: Timeline, start_s: float, end_s: float) -> None:
    """Draw the views as steps, with a scale at the right.

    They are drawn in the main axes, so that text is in front of them.
    """
    most = 1.05 * max(len(timeline.views), 1)
    second = axes.twinx()
    second.spines[["top", "left", "right", "bottom"]].set_visible(False)
    second.yaxis.get_major_locator().set_params(integer=True)
    second.set_ylim(0.0, most)
    second.set_ylabel("views", color=ORANGE)
    second.tick_params(colors=SOFT, length=0)
    stamps_s = [0.0, *(view.stamp_s - start_s for view in timeline.views), end_s]
    count = np.array([*range(len(timeline.views) + 1), len(timeline.views)])
    axes.step(stamps_s, 100.0 * count / most, where="post", color=ORANGE, lw=1.8, label="views")


def _draw_mark(axes: Any, text: str, reached_s: float, recall: float) -> None:
    """Draw a vertical line from the curve to the time axis, with text along it."""
    axes.plot([reached_s, reached_s], [0.0, recall], color=INK, lw=1.0, ls="--")
    axes.plot([reached_s], [recall], "o", color=INK, ms=6.0, mec="white", mew=1.0, zorder=5)
    place = (reached_s, 0.0)
    axes.annotate(
        text, place, (-3, 6), textcoords="offset points", rotation=90, ha="right", va="bottom", fontsize=9, color=INK,
    )  # fmt: skip
