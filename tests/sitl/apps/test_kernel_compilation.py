"""What is compiled ahead is what a flight needs: a kernel that is missing there costs seconds in flight."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from sitl.apps import kernel_compilation
from sitl.apps.kernel_compilation import SIMULATOR, compile_and_load, flight_jobs
from sitl.scene.scene import Scene
from uav_recon.errors import UserError

pytestmark = pytest.mark.slow

PROBE = """
import importlib, sys
from pathlib import Path
from numba.core.dispatcher import Dispatcher
from rich.console import Console
from sitl.apps.kernel_compilation import flight_jobs, toy_config
from sitl.apps.lockstep import fly_in_lockstep
from sitl.apps.flight_config import flight_config
from sitl.apps.flight_folder import make_folder
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
options = SimOptions(scene="random:7", views=8, radius_m=0.15, mapper="depth-only", lockstep=True, mount="fixed:15",
    out=folder / "flight")
scene = load_scene(options.scene, radius_m=options.radius_m, fine=False)
make_folder(options.folder)
config = flight_config(options, scene, folder)
flown = fly_in_lockstep(options, config, scene, Console(quiet=True), lambda: False, timelapse=False)
assert flown.fault is None, flown.fault
assert compiled() == ahead, sorted(compiled() - ahead)
"""


def test_a_flight_needs_no_kernel_that_is_not_compiled_ahead(tmp_path: Path) -> None:
    # a fresh process: here, earlier tests have compiled whatever they needed
    probe = subprocess.run(
        [sys.executable, "-c", PROBE, str(tmp_path)], capture_output=True, text=True, check=False, timeout=600
    )
    assert probe.returncode == 0, probe.stderr


def test_the_scene_is_loaded_while_other_kernels_are_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    loaded: list[Scene] = []

    def compile_until_loaded(jobs: Any, _path: Path, _show: Any, stopped: Callable[[], bool], ended: Any, _failed: Any) -> None:
        assert jobs[0] is SIMULATOR
        assert not loaded  # its kernels are not compiled yet
        ended(SIMULATOR)
        deadline_s = time.monotonic() + 10.0
        while not loaded and not stopped() and time.monotonic() < deadline_s:
            time.sleep(0.001)
        assert loaded

    def load() -> Scene:
        loaded.append(scene)
        return scene

    scene = kernel_compilation._toy_scene()
    monkeypatch.setattr(kernel_compilation, "compile_kernels", compile_until_loaded)
    assert compile_and_load(flight_jobs(), Console(quiet=True), load) is scene


def test_a_refused_scene_stops_the_compilation(monkeypatch: pytest.MonkeyPatch) -> None:
    def compile_forever(_jobs: Any, _path: Path, _show: Any, stopped: Callable[[], bool], ended: Any, _failed: Any) -> None:
        ended(SIMULATOR)
        deadline_s = time.monotonic() + 10.0
        while not stopped():
            assert time.monotonic() < deadline_s
            time.sleep(0.001)

    def refuse() -> Scene:
        raise UserError("--start 9,9,0,0: outside the fence")

    monkeypatch.setattr(kernel_compilation, "compile_kernels", compile_forever)
    with pytest.raises(UserError, match="outside the fence"):
        compile_and_load(flight_jobs(), Console(quiet=True), refuse)
