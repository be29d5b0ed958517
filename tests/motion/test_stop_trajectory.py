from __future__ import annotations

import numpy as np
import pytest
from hall import BLUR_RADPS, CONFIG, MOTION, assert_rests, assert_within_limits

from uav_recon.types.trajectory import Setpoint


@pytest.mark.parametrize("total_rad", [2 * np.pi, -np.pi])
def test_look_round(total_rad: float) -> None:
    start = Setpoint.hold(np.array([0, 0, 1.0]), 0.5, 0.2)
    trajectory = MOTION.plan_turn(start, 2.0, total_rad, 8, 3)
    assert_within_limits(trajectory)
    assert_rests(trajectory, 0)
    assert_rests(trajectory, -1)
    views = [trajectory.setpoint_at(2.0 + view_s) for view_s in trajectory.views_s]
    np.testing.assert_allclose([view.yaw_rad - 0.5 for view in views], total_rad * np.arange(1, 9) / 8, atol=0.02)
    assert max(abs(view.yaw_rate_radps) for view in views) <= BLUR_RADPS
    assert np.allclose(trajectory.camera_pitch_down_rad, 0.2)
    assert np.ptp(trajectory.position_m, axis=0).max() < 1e-9


def test_looking_round_takes_little_longer_than_the_limits_demand() -> None:
    trajectory = MOTION.plan_turn(Setpoint.hold(np.zeros(3), 0.0), 0.0, 2 * np.pi, 8, 3)
    assert trajectory.duration_s < 13.0
    unseeing = MOTION.plan_turn(Setpoint.hold(np.zeros(3), 0.0), 0.0, 2 * np.pi, 0, 3)
    assert unseeing.duration_s < 360 / CONFIG.yaw_rate_degps + 1.2
    assert not len(unseeing.views_s)


def test_take_off_is_a_line() -> None:
    trajectory = MOTION.plan_line(Setpoint.hold(np.zeros(3), 0.5, 0.26), np.array([0, 0, 1.1]), 0.5, 1.0, 3)
    assert_within_limits(trajectory)
    assert np.linalg.norm(trajectory.velocity_mps, axis=1).max() <= CONFIG.tight_speed_mps + 1e-6
    np.testing.assert_allclose(trajectory.position_m[-1], [0, 0, 1.1], atol=1e-9)
    assert np.allclose(trajectory.camera_pitch_down_rad, 0.26) and not len(trajectory.views_s)


def test_a_line_to_where_it_stands_is_a_hold() -> None:
    here = np.array([1.0, 2.0, 1.1])
    trajectory = MOTION.plan_line(Setpoint.hold(here, 0.5), here, 0.5, 1.0, 3)
    assert np.abs(trajectory.position_m - here).max() < 1e-9
    assert_rests(trajectory, -1)
