"""A person crosses before a vehicle that hovers, or flies forwards."""

from __future__ import annotations

import math
import random
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sitl.faults.injectors import crossing_person
from sitl.faults.injectors.base import InjectionContext
from sitl.faults.injectors.crossing_person import (
    CROSSED,
    GONE,
    HALF_M,
    HALF_TAN,
    LEFT,
    NEAR_M,
    PersonCrosses,
    is_clear,
    walk_before,
)

NOTHING = np.zeros((0, 3), np.float32)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("yaw_rad", [0.0, 0.7, math.pi / 2])
@pytest.mark.parametrize("near_m", NEAR_M)
def test_the_walk_leads_across_the_image_from_outside_to_outside(side: int, yaw_rad: float, near_m: float) -> None:
    walk = walk_before((1.0, 2.0, 1.2), yaw_rad, 0.0, near_m, 1.0, side, 10.0)
    x, y, z = np.array([walk.place(t) for t in np.linspace(10.0, walk.end_s, 400)]).T
    ahead = (x - 1.0) * math.cos(yaw_rad) + (y - 2.0) * math.sin(yaw_rad)
    left = (y - 2.0) * math.cos(yaw_rad) - (x - 1.0) * math.sin(yaw_rad)
    half_m = HALF_M[0] * (abs(math.cos(yaw_rad)) + abs(math.sin(yaw_rad)))
    np.testing.assert_allclose(ahead - half_m, near_m, atol=1e-9)
    assert np.sign(left[0]) == side and left[-1] == pytest.approx(-left[0])
    assert abs(left[0]) - half_m > HALF_TAN * (near_m + 2.0 * half_m), "outside the image, as a whole"
    np.testing.assert_allclose(z - HALF_M[2], crossing_person.FLOOR_M)


def test_the_walk_is_free_of_the_scene_where_the_camera_sees_it() -> None:
    walk = walk_before((0.0, 0.0, 1.2), 0.0, 0.0, 1.0, 1.0, 1, 0.0)
    middle = np.array([[1.25, 0.0, 1.0]], np.float32)
    assert not is_clear(walk, middle)
    assert is_clear(walk, middle + np.array([1.0, 0.0, 0.0], np.float32))
    assert is_clear(walk, np.array([[1.25, 0.0, -0.1]], np.float32)), "the floor"


class Flight:
    """A context whose vehicle is moved by the test."""

    def __init__(self, speed_mps: float) -> None:
        self.camera = SimpleNamespace(renderer=None)
        self.heading_rad = 0.0
        self.speed_mps = speed_mps
        world = SimpleNamespace(
            flyer=SimpleNamespace(truth=self._truth),
            camera=self.camera,
            clearance=SimpleNamespace(bins=SimpleNamespace(points=NOTHING)),
        )
        channels = SimpleNamespace(voxels=SimpleNamespace(latest=lambda: None))
        self.at = InjectionContext(cast("Any", world), dice=random.Random(3), channels=channels)

    def _truth(self) -> Any:
        quat = (math.cos(self.heading_rad / 2), 0.0, 0.0, math.sin(self.heading_rad / 2))
        return SimpleNamespace(
            position=(0.0, 0.0, 1.2), velocity=(self.speed_mps, 0.0, 0.0), quat_wxyz=quat, armed=True, mode="OFFBOARD"
        )

    def fly(self, person: PersonCrosses, from_s: float, until_s: float) -> None:
        for now_s in np.arange(from_s, until_s, 0.05):
            self.at.now_s = float(now_s)
            person.turn(self.at, float(now_s))


@pytest.mark.parametrize(("hovering", "speed_mps", "comes"), [(True, 0.0, True), (True, 0.3, False), (False, 0.0, False)])
def test_the_person_comes_in_the_state_that_is_asked_for(hovering: bool, speed_mps: float, comes: bool) -> None:
    flight, person = Flight(speed_mps), PersonCrosses(hovering)
    person.begin(flight.at)
    flight.fly(person, 0.0, 1.0)
    assert (CROSSED in flight.at.notes) is comes
    assert len(flight.at.obstacles) == comes


def test_the_person_is_gone_once_nobody_can_see_it() -> None:
    flight, person = Flight(0.0), PersonCrosses(hovering=True)
    person.begin(flight.at)
    flight.fly(person, 0.0, 40.0)
    (body,) = flight.at.obstacles
    left_s = flight.at.notes[LEFT]
    assert body.place(left_s + 0.1) == GONE
    x, y, _ = body.place(left_s - 0.1)
    assert abs(math.atan2(y, x)) > math.atan(HALF_TAN)


def test_a_vehicle_that_looks_after_the_person_sees_it_go_on() -> None:
    flight, person = Flight(0.0), PersonCrosses(hovering=True)
    person.begin(flight.at)
    flight.fly(person, 0.0, 1.0)
    (body,) = flight.at.obstacles
    for now_s in np.arange(1.0, 15.0, 0.05):
        x, y, _ = body.place(float(now_s))
        flight.heading_rad = math.atan2(y, x)
        flight.fly(person, float(now_s), float(now_s) + 0.01)
    assert LEFT not in flight.at.notes
