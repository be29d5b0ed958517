"""Plots of a flight as PNG.

Path over the floor plan; coverage, planning time and uncertainty of the place over time.
Every figure is a separate object on the Agg canvas; no state is shared and no display is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from uav_recon.geometry.view_information import BLIND_M, GOOD_M
from uav_recon.recording.flight_log import PhaseRecord, Timeline
from uav_recon.recording.report import BLIND_SIGMA_M, WEAK_SIGMA_M
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import FREE, OCCUPIED, VoxelMap

INK = "#1f2933"
SOFT = "#7b8794"
GRID = "#e4e7eb"
BLUE = "#2563eb"
ORANGE = "#ea7317"
GREEN = "#16a34a"
RED = "#dc2626"
_DPI = 150
_WIDTH_IN = 8.0
_PHASE_SHADES = ("#f5f7fa", "#ffffff")


def path_over_plan(
    picture: Path, timeline: Timeline, voxels: VoxelMap | None, slab_m: tuple[float, float] = (0.4, 1.6)
) -> None:
    """Plot the path over the floor plan: occupied grey, free white, unknown hatched.

    The path is coloured by time, the views are arrows. A column of voxels is occupied if any voxel between the two heights
    of ``slab_m`` (world z) is.
    """
    stamps_s, path = timeline.path_world()
    lower, upper = _extent(path, voxels)
    size = np.maximum(upper - lower, 1.0)
    figure = new_figure(_WIDTH_IN, float(np.clip(0.86 * _WIDTH_IN * size[1] / size[0], 2.4, 8.0)) + 1.2)
    axes = figure.add_subplot()
    style(axes, "x, m", "y, m", "Flown path over the floor plan")
    axes.grid(False)
    if voxels is not None:
        _draw_plan(axes, voxels, slab_m)
    if len(path) > 1:
        _draw_path(figure, axes, stamps_s - timeline.start_s(), path)
    _draw_views(axes, timeline)
    if len(path):
        axes.plot(*path[0, :2], "o", color=GREEN, ms=11, mec="white", mew=1.5, zorder=6, label="start")
        axes.plot(*path[-1, :2], "s", color=RED, ms=9, mec="white", mew=1.5, zorder=6, label="landing")
    axes.set_xlim(lower[0], upper[0])
    axes.set_ylim(lower[1], upper[1])
    axes.set_aspect("equal")
    handles, _ = axes.get_legend_handles_labels()
    handles += _plan_handles(voxels is not None)
    figure.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False, fontsize=9)
    save(figure, picture)


def coverage_over_time(picture: Path, timeline: Timeline, free_volume_m3: float | None = None) -> None:
    """Plot explored volume and views over flight time.

    free_volume_m3: free volume that can be seen; if given, the explored share is plotted.
    """
    start_s = timeline.start_s()
    time_s = np.array([sample.stamp_s - start_s for sample in timeline.progress])
    explored = np.array([sample.explored_m3 for sample in timeline.progress])
    figure = new_figure(_WIDTH_IN, 3.6)
    axes = figure.add_subplot()
    what = "explored, m³" if free_volume_m3 is None else "explored, % of what can be seen"
    style(axes, "flight time, s", what, "Coverage")
    if free_volume_m3 is not None:
        explored = 100.0 * explored / free_volume_m3
    axes.fill_between(time_s, explored, color=BLUE, alpha=0.12, lw=0)
    axes.plot(time_s, explored, color=BLUE, lw=2.2)
    axes.set_ylim(0.0, 1.2 * max(float(explored.max(initial=0.0)), 1e-3))  # the names of the phases are above the curves
    axes.yaxis.label.set_color(BLUE)
    second = axes.twinx()
    second.spines[["top", "left", "right", "bottom"]].set_visible(False)
    views = np.array([sample.views for sample in timeline.progress])
    second.step(time_s, views, where="post", color=ORANGE, lw=2.0)
    second.set_ylabel("views", color=ORANGE)
    second.tick_params(colors=SOFT, length=0)
    second.set_ylim(0.0, 1.2 * max(int(views.max(initial=0)), 1))
    end_s = float(time_s[-1]) if len(time_s) else 1.0
    axes.set_xlim(0.0, max(end_s, 1.0))
    _draw_phases(axes, timeline.phases, start_s, end_s)
    save(figure, picture)


def planning_over_time(picture: Path, timeline: Timeline) -> None:
    """Plot the time per plan: the whole step as a bar, its task time darker; colour by mode."""
    start_s = timeline.start_s()
    figure = new_figure(_WIDTH_IN, 3.4)
    axes = figure.add_subplot()
    style(axes, "flight time, s", "time per plan, ms", "Planning")
    for mode, colour, name in (
        ("explore", BLUE, "explore"),
        ("merged", ORANGE, "explore + reconstruct"),
        ("", SOFT, "nothing left"),
    ):
        plans = [plan for plan in timeline.plans if plan.mode == mode]
        if not plans:
            continue
        time_s = [plan.stamp_s - start_s for plan in plans]
        step_ms = [1e3 * plan.step_s for plan in plans]
        axes.vlines(time_s, 0.0, step_ms, color=colour, alpha=0.35, lw=2.4)
        axes.vlines(time_s, 0.0, [1e3 * plan.task_s for plan in plans], color=colour, lw=2.4)
        axes.plot(time_s, step_ms, "o", color=colour, ms=5.0, mec="white", mew=0.8, label=f"{name} ({len(plans)})")
    axes.set_ylim(0.0, 1.25e3 * max((plan.step_s for plan in timeline.plans), default=0.1))
    if timeline.plans:
        axes.vlines([], 0.0, [], color=INK, lw=2.4, label="dark: making tasks")
        axes.legend(loc="upper center", frameon=False, fontsize=8.5, ncols=4, columnspacing=1.2, handletextpad=0.4)
    save(figure, picture)


def place_sigma_over_time(picture: Path, timeline: Timeline) -> None:
    """Plot the standard deviation of the place in the air, predicted beside measured.

    The limits of each are horizontal lines.
    """
    start_s = timeline.start_s()
    stamps_s, predicted_m, measured_m = timeline.place_sigmas_m()
    time_s = stamps_s - start_s
    end_s = max(float(time_s.max(initial=0.0)), 1.0)
    figure = new_figure(_WIDTH_IN, 4.2)
    axes = figure.add_subplot()
    style(axes, "flight time, s", "standard deviation, cm", "Uncertainty of the place")
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.tick_params(which="minor", length=0)
    for sigma_m, colour, name, limits_m in (
        (measured_m, ORANGE, "measured", (WEAK_SIGMA_M, BLIND_SIGMA_M)),
        (predicted_m, BLUE, "predicted for the view", (GOOD_M, BLIND_M)),
    ):
        weak, blind = (100.0 * limit_m for limit_m in limits_m)
        axes.plot(time_s, 100.0 * sigma_m, color=colour, lw=1.8, label=name)
        axes.axhline(weak, color=colour, lw=1.2, ls=":", label=f"weak: {weak:g} cm")
        axes.axhline(blind, color=colour, lw=1.2, ls="--", label=f"blind: {blind:g} cm")
    known_cm = 100.0 * np.concatenate((predicted_m, measured_m))
    known_cm = known_cm[np.isfinite(known_cm)]
    least_cm, most_cm = max(float(known_cm.min(initial=0.2)), 0.02), float(known_cm.max(initial=10.0))
    axes.set_ylim(least_cm / 1.5, 8.0 * most_cm)  # the names of the phases are above the curves
    axes.set_xlim(0.0, end_s)
    _draw_phases(axes, timeline.phases, start_s, end_s)
    figure.legend(loc="outside lower center", ncols=6, frameon=False, fontsize=8.5, columnspacing=1.4, handletextpad=0.5)
    save(figure, picture)


def new_figure(width_in: float, height_in: float) -> Any:
    """Return an empty figure on its own Agg canvas."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    figure = Figure(
        figsize=(width_in, height_in), dpi=_DPI, layout=ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.12), facecolor="white"
    )
    FigureCanvasAgg(figure)
    return figure


def style(axes: Any, x: str, y: str, title: str) -> None:
    """Apply the common style: few lines, soft colours, title at the left."""
    axes.set_xlabel(x, color=SOFT)
    axes.set_ylabel(y, color=SOFT)
    axes.set_title(title, loc="left", color=INK, fontsize=14, fontweight="bold", pad=12)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(GRID)
    axes.tick_params(colors=SOFT, length=0)
    axes.grid(color=GRID, lw=0.8)
    axes.set_axisbelow(True)


def save(figure: Any, picture: Path) -> None:
    """Write the figure as PNG."""
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=_DPI)


def _extent(path: FloatArray, voxels: VoxelMap | None) -> tuple[FloatArray, FloatArray]:
    """Return the lower and upper corner (2,) of known space and path, with a margin."""
    points = [path[:, :2]]
    if voxels is not None:
        known = np.argwhere((voxels.state != 0).any(axis=2))
        if len(known):
            grid = voxels.grid
            points += [
                grid.origin_world_m[:2] + known * grid.resolution_m,
                grid.origin_world_m[:2] + (known + 1) * grid.resolution_m,
            ]
    corners = np.concatenate(points)
    if len(corners) == 0:
        return np.full(2, -1.0), np.full(2, 1.0)
    return corners.min(axis=0) - 0.3, corners.max(axis=0) + 0.3


def _draw_plan(axes: Any, voxels: VoxelMap, slab_m: tuple[float, float]) -> None:
    from matplotlib.patches import Rectangle

    grid = voxels.grid
    z = grid.origin_world_m[2] + (np.arange(grid.shape[2]) + 0.5) * grid.resolution_m
    slab = voxels.state[:, :, (z >= slab_m[0]) & (z <= slab_m[1])]
    occupied, free = (slab == OCCUPIED).any(axis=2), (slab == FREE).any(axis=2)
    picture = np.zeros((*occupied.shape, 4))
    picture[free] = (1.0, 1.0, 1.0, 1.0)
    picture[occupied] = (0.42, 0.47, 0.53, 1.0)
    low = grid.origin_world_m[:2]
    high = low + np.array(grid.shape[:2]) * grid.resolution_m
    axes.add_patch(
        Rectangle((low[0] - 50, low[1] - 50), *(high - low + 100), fc="#f0f2f5", ec="#d5dae1", hatch="////", lw=0, zorder=0)
    )
    extent = (low[0], high[0], low[1], high[1])
    axes.imshow(picture.transpose(1, 0, 2), origin="lower", extent=extent, interpolation="nearest", zorder=1)


def _draw_path(figure: Any, axes: Any, time_s: FloatArray, path: FloatArray) -> None:
    from matplotlib.collections import LineCollection

    segments = np.stack([path[:-1, :2], path[1:, :2]], axis=1)
    lines = LineCollection(list(segments), array=time_s[1:], cmap="plasma", lw=2.4, capstyle="round", zorder=3)
    axes.add_collection(lines)
    bar = figure.colorbar(lines, ax=axes, fraction=0.025, pad=0.015, aspect=30)
    bar.set_label("flight time, s", color=SOFT)
    bar.outline.set_visible(False)
    bar.ax.tick_params(colors=SOFT, length=0)


def _draw_views(axes: Any, timeline: Timeline) -> None:
    """Draw the position and the viewing direction of each keyframe."""
    if not timeline.views:
        return
    poses = [view.world_from_depth() for view in timeline.views]
    position = np.array([pose.translation_m[:2] for pose in poses])
    look = np.array([pose.rotation()[:2, 2] for pose in poses])
    look = 0.22 * look / np.maximum(np.linalg.norm(look, axis=1, keepdims=True), 1e-9)
    axes.quiver(
        *position.T,
        *look.T,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        width=0.0028,
        headwidth=4.5,
        color=INK,
        alpha=0.8,
        zorder=4,
    )


def _plan_handles(with_plan: bool) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [Line2D([], [], color=INK, marker=r"$\rightarrow$", ls="", ms=12, label="view")]
    if with_plan:
        handles += [
            Patch(fc="#6b7885", label="occupied"),
            Patch(fc="white", ec="#cbd2d9", label="free"),
            Patch(fc="#f0f2f5", ec="#cbd2d9", hatch="////", lw=0, label="unknown"),
        ]
    return handles


def _draw_phases(axes: Any, phases: Sequence[PhaseRecord], start_s: float, end_s: float) -> None:
    """Draw phases as pale bands, with their names where they fit."""
    last_label_s = -np.inf
    for n, record in enumerate(phases):
        begin = record.stamp_s - start_s
        end = phases[n + 1].stamp_s - start_s if n + 1 < len(phases) else end_s
        axes.axvspan(begin, max(begin, end), color=_PHASE_SHADES[n % 2], zorder=-2, lw=0)
        if begin - last_label_s > 0.02 * end_s and begin < 0.99 * end_s:
            axes.text(
                begin, 1.0, f" {record.phase.lower()}", transform=axes.get_xaxis_transform(),
                fontsize=8, color=SOFT, rotation=90, va="top", ha="left",
            )  # fmt: skip
            last_label_s = begin
