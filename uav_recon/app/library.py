"""Preparation for use as a library: compiles the kernels of the public classes."""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np

Progress = Callable[[str, int, int], None]  # what is compiled now, stages done, all stages


def print_progress(stage: str, done: int, total: int) -> None:
    """Show the progress on stderr: one live line on a terminal, else one plain line per stage."""
    from rich.console import Console

    console, last = Console(stderr=True, highlight=False), done == total
    text = f"{stage}" if last else f"compiling kernels ({done + 1}/{total}): {stage}"
    if console.is_terminal:
        sys.stderr.write("\r\x1b[2K")
        console.print(text, markup=False, no_wrap=True, overflow="ellipsis", end="\n" if last else "")
    else:
        console.print(text, markup=False, soft_wrap=True)


def warm_up(progress: Progress | None = print_progress) -> None:
    """Compile every kernel of OccupancyMapper, ViewPlanner and NeuralMapper.

    Takes minutes once per installation: numba keeps the result on disk; then seconds. Without this call each class compiles
    what it needs at its first use. progress: called before each stage as (stage, stages done, all stages), and at the end
    with done == total; None for silence.
    """
    stages = {"occupancy map": _occupancy, "view planner": _planner, "neural mapper": _neural}
    for done, (stage, compile_stage) in enumerate(stages.items()):
        if progress is not None:
            progress(stage, done, len(stages))
        compile_stage()
    if progress is not None:
        progress("kernels are compiled", len(stages), len(stages))


def _occupancy() -> None:
    from uav_recon.mapping.occupancy.occupancy_mapper import OccupancyMapper
    from uav_recon.types.rgbd_camera import Camera

    OccupancyMapper(Camera.d435i(), np.zeros(3), np.ones(3)).warm_up()


def _planner() -> None:
    from uav_recon.planning import view_planner

    view_planner.warm_up("adaptive")


def _neural() -> None:
    from uav_recon.mapping.neural.neural_mapper import NeuralMapper
    from uav_recon.types.rgbd_camera import Camera

    NeuralMapper.for_box(np.zeros(3), np.ones(3), Camera.d435i()).warm_up()
