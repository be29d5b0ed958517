"""The nearest return in the travel cone, against depth frames whose answer is known by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from uav_recon.safety.proximity import nearest_in_cone
from uav_recon.types.camera import Intrinsics
from uav_recon.types.frames import Float32Array

CAMERA = Intrinsics.from_fov(85, 49, math.radians(87), math.radians(58))
AHEAD = np.array([0.0, 0.0, 1.0])


def wall(distance_m: float) -> Float32Array:
    return np.full((49, 85), distance_m, dtype=np.float32)


def test_a_wall_ahead_is_as_far_as_it_is() -> None:
    assert nearest_in_cone(wall(2.0), CAMERA, AHEAD, 0.3) == pytest.approx(2.0, rel=1e-3)


def test_a_thin_post_before_the_wall_counts_and_a_speckle_does_not() -> None:
    depth = wall(3.0)
    depth[:, 42] = 1.0
    assert nearest_in_cone(depth, CAMERA, AHEAD, 0.3) == pytest.approx(1.0, rel=2e-2)
    speckle = wall(3.0)
    speckle[24, 42] = 0.4
    assert nearest_in_cone(speckle, CAMERA, AHEAD, 0.3) == pytest.approx(3.0, rel=1e-2)


def test_what_lies_beside_the_cone_does_not_count() -> None:
    depth = wall(3.0)
    depth[:, :10] = 0.5  # far left
    assert nearest_in_cone(depth, CAMERA, AHEAD, 0.3) == pytest.approx(3.0, rel=1e-2)
    assert nearest_in_cone(depth, CAMERA, np.array([-0.85, 0.0, 1.0]), 0.3) < 0.8


@pytest.mark.parametrize("nothing", [math.nan, 0.0, -1.0, math.inf])
def test_no_return_is_no_distance(nothing: float) -> None:
    assert nearest_in_cone(wall(nothing), CAMERA, AHEAD, 0.3) == math.inf
    half = wall(1.5)
    half[:24] = nothing
    assert nearest_in_cone(half, CAMERA, AHEAD, 0.3) == pytest.approx(1.5, rel=1e-2)


def test_no_direction_gives_no_cone_and_a_wrong_shape_is_a_bug() -> None:
    assert nearest_in_cone(wall(1.0), CAMERA, np.zeros(3), 0.3) == math.inf
    with pytest.raises(ValueError, match="intrinsics say"):
        nearest_in_cone(wall(1.0)[1:], CAMERA, AHEAD, 0.3)
