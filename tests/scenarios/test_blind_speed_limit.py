"""With the rule of blind directions on: a flight is completed, and by the truth it is slow where its camera does not look."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sitl.apps.sim import simulate
from sitl.apps.sim_options import SimOptions
from uav_recon.recording.report import Report
from uav_recon.types.frames import FloatArray

pytestmark = [pytest.mark.slow, pytest.mark.nightly]
VIEWS = 20
COLUMN_M = 0.3
FAST_MPS = 0.45  # 0.30, and what a vehicle is faster than its setpoints
HALF_TAN = np.tan(np.radians([87.0, 58.0]) / 2)
CAMERA_FROM_BODY = (
    np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]) @ Rotation.from_euler("y", -15, True).as_matrix()
)


def blind_and_fast_m(folder: Path) -> tuple[float, float]:
    """Of the way that was flown: metres out of the picture at more than FAST_MPS, and all. Above the pad is the column that the
    first frames have confirmed.
    """
    with np.load(folder / "truth.npz") as truth:
        stamp_s, place_m, quat = truth["stamp_s"], truth["position_m"], truth["quat_wxyz"]
    step_m: FloatArray = np.diff(place_m, axis=0)
    body = Rotation.from_quat(quat[:-1, [1, 2, 3, 0]]).inv().apply(step_m)
    x, y, z = (body @ CAMERA_FROM_BODY.T).T
    above_pad = np.hypot(place_m[:-1, 0], place_m[:-1, 1]) < COLUMN_M
    seen = above_pad | (z > 0.0) & (np.abs(x) <= HALF_TAN[0] * z) & (np.abs(y) <= HALF_TAN[1] * z)
    length_m = np.linalg.norm(step_m, axis=1)
    fast = length_m > FAST_MPS * np.diff(stamp_s)
    return float(length_m[fast & ~seen].sum()), float(length_m.sum())


def fly(folder: Path, blind_speed: float) -> Report:
    options = SimOptions(
        views=VIEWS, seed=1, lockstep=True, mount="fixed:15", mapper="depth-only", out=folder, blind_speed_mps=blind_speed
    )
    assert simulate(options) == 0
    return Report.load(folder / "report.json")


def test_it_is_slow_where_it_does_not_look_and_gets_round_all_the_same(tmp_path: Path) -> None:
    report = fly(tmp_path / "careful", 0.3)
    assert report.outcome == "completed"
    assert report.safety.contacts == 0
    assert report.safety.min_clearance_m is not None
    assert report.safety.min_clearance_m >= 0.10
    blind_m, way_m = blind_and_fast_m(tmp_path / "careful")
    assert blind_m < 0.02 * way_m
    fly(tmp_path / "usual", 1.2)
    blind_m, way_m = blind_and_fast_m(tmp_path / "usual")
    assert blind_m > 0.3 * way_m, "without it most of the way is flown that nobody looks at"
