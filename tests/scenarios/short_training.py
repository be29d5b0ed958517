"""`uav-recon` with a short training after the landing, for flights whose model need not be the best one.

Run as a program, it takes the arguments of `uav-recon`; the processes of a flight read the steps from its config.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from sitl.apps import sim
from sitl.apps.flight_config import flight_config
from sitl.apps.sim_options import SimOptions
from sitl.scene.scene import Scene
from uav_recon.cli.main import main
from uav_recon.config import Config

FINAL_STEPS = 300  # the default, 1500, takes a quarter of the time of a flight of 22 views


def shortened(options: SimOptions, scene: Scene, runtime: Path) -> Config:
    """The config of a flight, with FINAL_STEPS."""
    whole = flight_config(options, scene, runtime)
    return whole.model_copy(update={"mapper": whole.mapper.model_copy(update={"polish_steps": FINAL_STEPS})})


@contextmanager
def short_training() -> Iterator[None]:
    """Fly with FINAL_STEPS."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sim, "flight_config", shortened)
        yield


if __name__ == "__main__":
    with short_training():
        main()
