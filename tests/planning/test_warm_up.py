"""warm_up() compiles every kernel, because a compilation in flight costs a second or more."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

PROBE = """
import sys
import numpy as np
from numba.core.dispatcher import Dispatcher
sys.path.insert(0, sys.argv[1])
from box_world import GIMBAL, MEETING_ROOM, BoxWorld
from test_view_planner import surface_of
from uav_recon.config import PlannerConfig
from uav_recon.planning import view_planner
from uav_recon.planning.fallback_planner import FallbackPlanner
from uav_recon.planning.tour.travel_time import YawWhileFlying
from uav_recon.types.tasks import PlanRequest, Viewpoint

def compiled():
    kernels = {
        (name, key): value
        for name, module in list(sys.modules.items()) if name.startswith("uav_recon.")
        for key, value in vars(module).items() if isinstance(value, Dispatcher)
    }
    return {key: len(value.signatures) for key, value in kernels.items()}

CONFIG = PlannerConfig(clearance_m=float(sys.argv[2]))  # of a small vehicle, and of the largest
view_planner.warm_up(CONFIG.variant)
before = compiled()
assert len(before) > 15, before
world = BoxWorld(MEETING_ROOM, GIMBAL, np.array([3.0, 1.0, 1.2]))
world.look_round()
model = YawWhileFlying(0.8, 0.8)
usual = view_planner.ViewPlanner(CONFIG, np.zeros(3), np.array([6.2, 5.0, 2.4]), GIMBAL, model, passage_m=0.25)
planner = FallbackPlanner(usual, (CONFIG.clearance_m - 0.05,), CONFIG.clearance_m - 0.05)
for position in ((3.0, 1.0, 1.2), (3.0, 0.15, 1.2), (9.0, 9.0, 9.0)):
    asked = world.request()
    request = PlanRequest(asked.voxels, surface_of(MEETING_ROOM), np.array(position), 0.0, 50)
    planner.plan(request)
    planner.route(request, Viewpoint(np.array([5.0, 0.3, 1.2]), 0.0, 0.0))
    planner._route(request, Viewpoint(np.array([5.0, 0.3, 1.2]), 0.0, 0.0), CONFIG.clearance_m - 0.05, 0.0)
after = compiled()
assert before == after, {key: (before[key], after[key]) for key in before if before[key] != after[key]}
"""


@pytest.mark.parametrize("clearance_m", [0.3, 0.6])
def test_nothing_is_compiled_after_warm_up(clearance_m: float) -> None:
    # a fresh process, because earlier tests have compiled kernels in this one
    probe = subprocess.run(
        [sys.executable, "-c", PROBE, str(Path(__file__).parent), str(clearance_m)],
        capture_output=True,
        text=True,
        check=False,
        timeout=240,
    )
    assert probe.returncode == 0, probe.stderr
