"""Quick step sizes fly like the real ones, within the scatter of the wind."""

from __future__ import annotations

import numpy as np
import pytest
from scripted_companion import Companion

from sitl.autopilots.byte_links import pipe
from sitl.autopilots.px4.autopilot import Px4
from sitl.autopilots.px4.parameters import Px4Parameters
from sitl.world.quadrotor import Quadrotor
from sitl.world.step_sizes import COARSE_STEPS, FINE_STEPS, StepSizes
from uav_recon.app.processes import MISSION_RATE_HZ


class Paced(Companion):
    """Companion whose autopilot has the given step sizes."""

    def __init__(self, pace: StepSizes) -> None:
        super().__init__(seed=3)
        self.vehicle = Quadrotor(3, yaw_rad=0.3)
        end, self._pipe = pipe()
        self.autopilot = Px4(self.vehicle, end, Px4Parameters.load(), 3, pace.physics_s)
        self.px4.step(self.now_s)


def offsets_m(pace: StepSizes) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return the distance (N,) from the setpoint.

    It hovers for five seconds, makes a step of 1 m, and hovers for five more.
    """
    c = Paced(pace)
    c.take_off()
    found = []
    for goal in ((0.0, 0.0, -1.2), (1.0, 0.0, -1.2)):
        c.go_to(*goal)
        c.run(5.0 if goal[0] == 0.0 else 4.0)
        for _ in range(20):
            c.run(0.25)
            n, e, d = goal
            x, y, z = c.vehicle.position
            found.append(np.sqrt((y - n) ** 2 + (x - e) ** 2 + (z + d) ** 2))
    return np.array(found)


def test_hover_and_step_are_flown_equally_well() -> None:
    real, quick = offsets_m(FINE_STEPS), offsets_m(COARSE_STEPS)
    assert np.sqrt((quick**2).mean()) == pytest.approx(np.sqrt((real**2).mean()), rel=0.25, abs=0.01)
    assert quick.max() < 1.5 * real.max() + 0.02


def test_the_products_rates_divide_the_quick_step_rate() -> None:
    for rate_hz in (MISSION_RATE_HZ, 30.0, 6.0, 10.0, COARSE_STEPS.truth_hz):
        assert (1.0 / COARSE_STEPS.iteration_s) % rate_hz == pytest.approx(0.0, abs=1e-9)
    assert COARSE_STEPS.iteration_s / COARSE_STEPS.physics_s == pytest.approx(
        round(COARSE_STEPS.iteration_s / COARSE_STEPS.physics_s)
    )
