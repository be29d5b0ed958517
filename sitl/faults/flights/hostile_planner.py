"""A hostile planner: it sends well-formed messages with harmful trajectories to the pilot."""

from __future__ import annotations

import math
import random

import numpy as np
from numpy.typing import NDArray

from sitl.faults.injectors.base import InjectionContext, Injector
from uav_recon.config import Config
from uav_recon.types.trajectory import Goal, Intent, Trajectory


def hostile(scenario: str, config: Config) -> list[Injector]:
    """Return the additional injectors of scenario F1; none for any other scenario."""
    return [HostilePlanner(config)] if scenario == "F1" else []


class HostilePlanner(Injector):
    """Replacement of the mission, with a new harmful trajectory in every second turn."""

    def __init__(self, config: Config) -> None:
        self._low = np.array(config.safety.fence_min_m)
        self._high = np.array(config.safety.fence_max_m)
        self._identifier = 1 << 20
        self._turns = 0

    def stalls(self, since_s: float, stage: str) -> bool:
        """Stall the real mission."""
        return stage == "mission"

    def turn(self, at: InjectionContext, since_s: float) -> None:
        """Publish a harmful trajectory in every second turn."""
        self._turns += 1
        if self._turns % 2 == 0:
            self._identifier += 1
            at.channels.intent.publish(Intent(at.now_s, Goal.FLY, self._trajectory(at)))

    def _trajectory(self, at: InjectionContext) -> Trajectory:
        dice, count = at.dice, 60
        here = np.array(at.world.flyer.truth().position)
        along = np.linspace(0.0, 1.0, count)[:, None]
        place = here + along * (self._goal(dice) - here)
        velocity = np.gradient(place, 1.0 / 30.0, axis=0) * dice.choice((1.0, 1.0, 0.0, 5.0))
        velocity[-1] = 0.0
        push = np.full((count, 3), dice.choice((0.0, 0.0, 3.0, -50.0)))
        yaw = np.linspace(0.0, dice.choice((0.0, 0.0, 6.0, 300.0)), count)
        rate = np.full(count, dice.choice((0.0, 0.0, 2.0, 90.0)))
        for array in (place, velocity, push, yaw, rate):
            if dice.random() < 0.08:
                array[dice.randrange(count)] = dice.choice((math.nan, math.inf, -math.inf, 1e9))
        start_s = at.now_s + dice.choice((0.0, 0.0, -1.0, 3.0, -1e6, 1e9))
        epoch = dice.choice((0, 0, 0, 7))
        return Trajectory(
            start_s=start_s, step_s=1.0 / 30.0, position_m=place, velocity_mps=velocity, acceleration_mps2=push,
            yaw_rad=yaw, yaw_rate_radps=rate, camera_pitch_down_rad=np.zeros(count), views_s=np.zeros(0),
            map_epoch=epoch, identifier=self._identifier,
        )  # fmt: skip

    def _goal(self, dice: random.Random) -> NDArray[np.float64]:
        size = self._high - self._low
        share = np.array([dice.uniform(0.0, 1.0) for _ in range(3)])
        goals: tuple[NDArray[np.float64], ...] = (
            self._low + share * size,  # anywhere inside the fence, also in walls and pillars
            self._low + (share * 3.0 - 1.0) * size,
            np.full(3, dice.choice((1e9, -1e9, 1e3))),
        )
        return dice.choice(goals)
