"""Single wrong depth frames: ghosts, few returns, and none after the lift-off."""

from __future__ import annotations

import random
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sitl.faults.injectors import depth_camera
from sitl.faults.injectors.base import DepthFrame, InjectionContext


def frame(range_mm: int = 3000) -> DepthFrame:
    return DepthFrame(10.0, np.full((40, 60), range_mm, np.uint16), np.zeros((2, 3, 3), np.uint8))


@pytest.mark.parametrize("centred", [True, False])
def test_a_ghost_is_a_near_patch_before_what_is_behind_it(centred: bool) -> None:
    rng, change = np.random.default_rng(1), depth_camera.ghost(centred)
    places = set()
    for _ in range(20):
        seen = change(frame().depth_mm, rng)
        patch = seen != 3000
        assert patch.sum() == 10 * 15
        assert len(np.unique(seen[patch])) == 1
        assert 1100 <= seen[patch][0] <= 1500
        places.add(int(np.flatnonzero(patch)[0]))
    assert (len(places) == 1) is centred
    near = change(frame(800).depth_mm, rng)
    assert (near == 800).all(), "nothing behind a surface is seen"


def test_few_returns_are_left() -> None:
    left = depth_camera.thinned(0.1)(frame().depth_mm, np.random.default_rng(1))
    assert 0.05 <= np.mean(left > 0) <= 0.15


def test_frames_are_empty_for_a_while_after_the_lift_off() -> None:
    place = SimpleNamespace(position=(0.0, 0.0, 0.0))
    world = SimpleNamespace(flyer=SimpleNamespace(truth=lambda: place))
    at, fault = InjectionContext(cast("Any", world), random.Random(1)), depth_camera.EmptyAfterLiftOff(1.0)

    def seen(since_s: float) -> bool:
        fault.turn(at, since_s)
        return bool(fault.depth(since_s, frame())[0][1].depth_mm.any())

    assert seen(4.9)
    place.position = (0.0, 0.0, 0.2)
    assert not seen(5.0)
    assert not seen(5.9)
    assert seen(6.0)
