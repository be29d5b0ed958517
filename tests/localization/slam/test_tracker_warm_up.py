"""warm_up() compiles every kernel of the tracker, because a compilation in flight costs seconds."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

PROBE = """
import sys
import numpy as np
from numba.core.dispatcher import Dispatcher
sys.path[:0] = sys.argv[1:]
from slam_flight import BODY_FROM_DEPTH, fly, frame, frames
from uav_recon.localization.slam.prepared_view import PreparedView
from uav_recon.localization.slam.rgbd_registration import search
from uav_recon.localization.slam.slam_tracker import SlamTracker, warm_up

def compiled():
    kernels = {
        (name, key): value
        for name, module in list(sys.modules.items()) if name.startswith("uav_recon.")
        for key, value in vars(module).items() if isinstance(value, Dispatcher)
    }
    return {key: len(value.signatures) for key, value in kernels.items()}

warm_up()
before = compiled()
assert len(before) > 15, before
tracker = SlamTracker()
answers = fly(tracker, frames(5.0))
assert sum(answer.pose is not None for answer in answers) > 30
prior = tracker._predict(tracker._state, 5.0, BODY_FROM_DEPTH)
search(PreparedView(frame(75)), tracker.surfaces, prior, np.full(3, 0.2))
tracker.surfaces.recognise(PreparedView(frame(75)), prior.odom_from_depth, 0.2, 1.0)
after = compiled()
assert before == after, {key: (before[key], after[key]) for key in before if before[key] != after[key]}
"""


def test_nothing_is_compiled_in_flight() -> None:
    # a fresh process, because earlier tests have compiled kernels in this one
    here = Path(__file__).parent
    probe = subprocess.run(
        [sys.executable, "-c", PROBE, str(here), str(here.parent)], capture_output=True, text=True, check=False, timeout=240
    )
    assert probe.returncode == 0, probe.stderr
