"""Sensor output of the outside world while the simulating computer stalls."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sitl.outside_world import OutsideWorld


class Turning:
    """Autopilot whose vehicle turns ever faster, so that its gyro reading is the time."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def step(self, now_s: float) -> None:
        self.now_s = now_s

    def truth(self) -> Any:
        return SimpleNamespace(
            gyro=(self.now_s, 0.0, 0.0), specific_force=(0.0, 0.0, 9.8), position=(0.0, 0.0, 0.0),
            quat_wxyz=(1.0, 0.0, 0.0, 0.0), armed=False, mode="OFFBOARD", stamp_s=self.now_s, gimbal_pitch_down_rad=0.0,
        )  # fmt: skip


class Tape:
    def __init__(self) -> None:
        self.samples: list[tuple[float, float]] = []

    def write_imu(self, stamp_s: float, gyro_radps: Any, _: Any) -> None:
        self.samples.append((stamp_s, float(gyro_radps[0])))


def test_inertial_samples_are_of_their_own_time_even_if_the_step_is_late() -> None:
    tape, poses = Tape(), SimpleNamespace(due=lambda _: False)
    world = OutsideWorld(*cast(Any, (Turning(), None, poses, None, tape, 10.0, 0.0)))
    for now_s in (10.0, 10.01, 10.15):  # a stall of 0.14 s
        world.step(now_s)
    stamps, gyros = np.array(tape.samples).T
    assert len(stamps) == pytest.approx(0.15 * 200 + 1, abs=1)
    assert np.array_equal(stamps, gyros)
