"""What is compiled ahead is what a flight needs: a kernel that is missing there costs seconds in flight."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

PROBE = """
import importlib, sys
from pathlib import Path
from numba.core.dispatcher import Dispatcher
from rich.console import Console
from sitl.apps.kernel_compilation import flight_jobs, toy_config
from sitl.apps.lockstep import fly_in_lockstep
from sitl.apps.sim_options import SimOptions
from sitl.scene.scene import load_scene

def compiled():
    return {
        (name, key, str(signature))
        for name, module in list(sys.modules.items()) if name.startswith(("uav_recon.", "sitl."))
        for key, value in vars(module).items() if isinstance(value, Dispatcher)
        for signature in value.signatures
    }

folder = Path(sys.argv[1])
config_path = toy_config(folder)
for job in flight_jobs(("adaptive",), neural=False):
    module, _, name = job.function.partition(":")
    getattr(importlib.import_module(module), name)(config_path, job.argument)
ahead = compiled()
assert len(ahead) > 80, len(ahead)
options = SimOptions.parse(scene="random:7", views=8, radius=0.15, mapper="stand-in", lockstep=True, out=folder / "flight")
scene = load_scene(options.scene, radius_m=options.radius_m, fine=False)
options.make_folder()
flown = fly_in_lockstep(options, options.config(scene, folder), scene, Console(quiet=True), lambda: False, timelapse=False)
assert flown.fault is None, flown.fault
assert compiled() == ahead, sorted(compiled() - ahead)
"""


def test_a_flight_needs_no_kernel_that_is_not_compiled_ahead(tmp_path: Path) -> None:
    # a fresh process: here, earlier tests have compiled whatever they needed
    probe = subprocess.run(
        [sys.executable, "-c", PROBE, str(tmp_path)], capture_output=True, text=True, check=False, timeout=600
    )
    assert probe.returncode == 0, probe.stderr
