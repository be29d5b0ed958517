"""One pose that leaps there and back is left out; a leap that stays is passed on one pose late."""

from __future__ import annotations

import numpy as np

from uav_recon.localization.exclusion.spike_filter import SpikeFilter
from uav_recon.types.pose import Pose, StampedPose


def passed(*x_m: float, period_s: float = 0.033) -> list[list[float]]:
    spikes, out = SpikeFilter(), []
    for n, x in enumerate(x_m):
        pose = StampedPose(n * period_s, Pose.from_yaw(0.0, np.array([x, 0.0, 0.0])), np.zeros(3))
        out.append([float(each.odom_from_body.translation_m[0]) for each in spikes.passed(pose)])
    return out


def test_a_pose_that_its_neighbours_contradict_is_left_out() -> None:
    assert passed(0.0, 0.03, 0.5, 0.06, 0.09) == [[0.0], [0.03], [], [0.06], [0.09]]


def test_a_leap_that_stays_is_passed_with_the_next_pose() -> None:
    assert passed(0.0, 0.5, 0.52, 0.54) == [[0.0], [], [0.5, 0.52], [0.54]]


def test_what_a_vehicle_can_fly_is_no_leap() -> None:
    assert passed(0.0, 0.2, 0.4, period_s=0.05) == [[0.0], [0.2], [0.4]]
    assert passed(0.0, 0.6, 0.6, period_s=0.3) == [[0.0], [0.6], [0.6]]


def test_after_a_restart_the_first_pose_is_passed() -> None:
    spikes = SpikeFilter()
    here, there = (StampedPose(x, Pose.from_yaw(0.0, np.array([x, 0.0, 0.0])), np.zeros(3)) for x in (0.0, 0.4))
    spikes.passed(here)
    spikes.forget()
    assert spikes.passed(there) == [there]
