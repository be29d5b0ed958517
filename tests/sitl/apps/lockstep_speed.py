"""Measure the speed of lockstep.

Usage: `python tests/sitl/apps/lockstep_speed.py [SCENE [VIEWS [SEED]]]`. It flies with the depth-only mapper.
The speed of a shared machine changes within a minute. Therefore it is measured every two seconds between two turns of the
flight. That time is not counted, and the flight's time is divided by the mean of all these slowdowns.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.console import Console

from sitl.apps.flight_config import flight_config
from sitl.apps.flight_folder import make_folder
from sitl.apps.lockstep import NoHook, fly_in_lockstep
from sitl.apps.sim_options import SimOptions
from sitl.apps.sweep_case import one_thread
from sitl.scene.scene import load_scene
from uav_recon.measurement.machine_speed import measure_machine_speed

EVERY_S = 2.0


class Stopwatch(NoHook):
    """Hook that measures the speed of the machine every EVERY_S; ``took_s`` is the time that this took."""

    def __init__(self) -> None:
        self.factors: list[float] = []
        self.took_s = 0.0
        self._next_s = 0.0

    def turn(self, now_s: float) -> None:
        """Measure, if it is due."""
        began_s = time.perf_counter()
        if began_s >= self._next_s:
            self.factors.append(measure_machine_speed(5).slowdown)
            self._next_s = time.perf_counter()
            self.took_s += self._next_s - began_s
            self._next_s += EVERY_S


def main(scene_name: str | None, views: int, seed: int) -> None:
    """Fly once and print one line."""
    with tempfile.TemporaryDirectory(prefix="uav_recon-") as folder:
        options = SimOptions(
            scene=scene_name, seed=seed, views=views, mount="fixed:15", camera="fast", mapper="depth-only", lockstep=True,
            out=Path(folder) / "flight",
        )  # fmt: skip
        scene = load_scene(options.scene, options.start_pose, options.fence_corners, options.radius_m, fine=False)
        make_folder(options.folder)
        watch = Stopwatch()
        config = flight_config(options, scene, Path(folder))
        flight = fly_in_lockstep(options, config, scene, Console(quiet=True), lambda: False, timelapse=False, hook=watch)
    wall_s, factor = flight.wall_s - watch.took_s, float(np.mean(watch.factors))
    low, high = np.percentile(watch.factors, [5, 95])
    raw = flight.simulated_s / wall_s
    print(
        f"{scene_name or 'built-in'}: {flight.simulated_s:.0f} s flown in {wall_s:.1f} s, {raw:.1f} times real time; "
        f"slowdown {factor:.2f} ({low:.2f} to {high:.2f}): {raw * factor:.1f} calibrated"
    )


if __name__ == "__main__":
    one_thread()
    words = sys.argv[1:]
    main(words[0] if words else None, int(words[1]) if len(words) > 1 else 120, int(words[2]) if len(words) > 2 else 0)
