"""A firmware's own true state becomes the true path in the world.

This holds for any direction of its north.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sitl.geometry.quaternion import Quat, Vec3
from sitl.real_firmware.true_trajectory import Inertial, PositionResolution, Reading, TrueTrajectory

LEVEL: Quat = (1.0, 0.0, 0.0, 0.0)
GRAIN = PositionResolution(metres_per_e7=0.011131884502145034, height_step_m=0.01)
LATITUDE_E7, LONGITUDE_E7, HEIGHT_M = 473977420, 85455940, 500.0


def ned_from_frd(yaw_deg: float, pitch_deg: float = 0.0, roll_deg: float = 0.0) -> Quat:
    """Return an attitude by the aviation convention.

    Heading is clockwise from north, pitch is nose up, roll is right wing down.
    """
    x, y, z, w = Rotation.from_euler("ZYX", [yaw_deg, pitch_deg, roll_deg], degrees=True).as_quat().tolist()
    return (w, x, y, z)


def reading(
    north_m: float = 0.0, east_m: float = 0.0, up_m: float = 0.0, ned_mps: Vec3 = (0.0, 0.0, 0.0), attitude: Quat = LEVEL
) -> Reading:
    """Return the message of a firmware for a vehicle at this position.

    Values are whole units, truncated towards zero as the firmware's offsets are.
    """
    scale = math.cos(math.radians(LATITUDE_E7 * 1e-7))
    return Reading(
        LATITUDE_E7 + int(north_m / GRAIN.metres_per_e7),
        LONGITUDE_E7 + int(east_m / GRAIN.metres_per_e7 / scale),
        HEIGHT_M + int(up_m * 100) / 100,
        ned_mps,
        attitude,
    )


def forward(path: TrueTrajectory, now_s: float) -> NDArray[np.float64]:
    w, x, y, z = path.at(now_s).quat_wxyz
    return np.asarray(Rotation.from_quat([x, y, z, w]).apply([1.0, 0.0, 0.0]), np.float64)


def test_the_pad_is_the_origin_and_its_heading_that_of_the_scene() -> None:
    for heading_deg in (0.0, 90.0, -137.0):
        path = TrueTrajectory(GRAIN, math.radians(30.0))
        begun = [path.begun]
        path.take(1.0, reading(attitude=ned_from_frd(heading_deg)))
        begun.append(path.begun)
        assert begun == [False, True]
        assert path.at(1.0).position == (0.0, 0.0, 0.0)
        np.testing.assert_allclose(forward(path, 1.0), [math.cos(math.pi / 6), 0.5, 0.0], atol=1e-12)


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 215.0])
def test_offsets_from_the_pad_are_rotated_into_the_world(heading_deg: float) -> None:
    """On the pad the heading is heading_deg; the scene's heading is along the world's x axis."""
    path = TrueTrajectory(GRAIN, 0.0)
    path.take(1.0, reading(attitude=ned_from_frd(heading_deg)))
    ahead, left = math.radians(heading_deg), math.radians(heading_deg - 90.0)
    north, east = math.cos(ahead) + 0.5 * math.cos(left), math.sin(ahead) + 0.5 * math.sin(left)
    path.take(3.0, reading(north, east, 0.4, attitude=ned_from_frd(heading_deg + 90.0)))
    np.testing.assert_allclose(path.at(3.0).position, [1.0, 0.5, 0.4], atol=0.03)
    np.testing.assert_allclose(forward(path, 3.0), [0.0, -1.0, 0.0], atol=1e-9)  # turned right


def test_pitch_up_and_roll_right_have_the_correct_signs() -> None:
    path = TrueTrajectory(GRAIN, 0.0)
    path.take(1.0, reading())
    path.take(2.0, reading(attitude=ned_from_frd(0.0, 20.0)))
    assert forward(path, 2.0)[2] == pytest.approx(math.sin(math.radians(20.0)))
    path.take(3.0, reading(attitude=ned_from_frd(0.0, 0.0, 10.0)))
    w, x, y, z = path.at(3.0).quat_wxyz
    assert Rotation.from_quat([x, y, z, w]).apply([0.0, 1.0, 0.0])[2] == pytest.approx(math.sin(math.radians(10.0)))


def test_velocity_is_in_world_axes_and_inertial_data_in_body_axes() -> None:
    path = TrueTrajectory(GRAIN, 0.0)  # the firmware's north is the world's x axis
    path.set_inertial(Inertial((0.1, 0.2, 0.3), (1.0, 2.0, -9.8)))
    path.take(1.0, reading(ned_mps=(0.6, 0.2, -0.1)))
    motion = path.at(1.0)
    np.testing.assert_allclose(motion.velocity, [0.6, -0.2, 0.1], atol=1e-12)
    assert motion.gyro == (0.1, -0.2, -0.3)
    assert motion.specific_force == (1.0, -2.0, 9.8)


def test_the_path_between_coarse_readings_is_smooth() -> None:
    """A slow, curved flight, read to whole centimetres at 50 Hz.

    The error stays below 1.2 cm, and the path has no steps.
    """
    path = TrueTrajectory(GRAIN, math.pi / 2.0)  # the world frame equals ENU
    worst_m, furthest_m, before = 0.0, 0.0, np.zeros(3)
    for tick in range(1500):
        t = tick / 50.0
        east, north, up = 2.0 * math.sin(0.1 * t), 3.0 - 3.0 * math.cos(0.1 * t), 0.03 * t
        ned = (0.3 * math.sin(0.1 * t), 0.2 * math.cos(0.1 * t), -0.03)
        path.take(100.0 + t, reading(north, east, up, ned))
        found = np.array(path.at(100.0 + t).position)
        worst_m = max(worst_m, float(np.abs(found - [east, north, up]).max()))
        if tick:
            furthest_m = max(furthest_m, float(np.linalg.norm(found - before)))
        before = found
    assert worst_m <= 0.012
    assert furthest_m <= 0.35 / 50.0 + 0.002  # the coarse readings jump by 0.011


def test_the_path_is_extrapolated_for_a_short_time_only() -> None:
    path = TrueTrajectory(GRAIN, math.pi / 2.0)
    path.set_inertial(Inertial((0.0, 0.0, -1.0), (0.0, 0.0, -9.8)))
    path.take(1.0, reading(ned_mps=(0.5, 0.0, 0.0)))
    np.testing.assert_allclose(path.at(1.05).position, [0.0, 0.025, 0.0], atol=1e-12)
    np.testing.assert_allclose(forward(path, 1.05), [-math.sin(0.05), math.cos(0.05), 0.0], atol=1e-5)  # turning left
    np.testing.assert_allclose(path.at(9.0).position, [0.0, 0.05, 0.0], atol=1e-12)


def test_an_older_reading_is_ignored() -> None:
    path = TrueTrajectory(GRAIN, 0.0)
    path.take(1.0, reading())
    path.take(2.0, reading(north_m=1.0))
    before = path.at(2.0)
    path.take(1.5, reading(north_m=7.0))
    assert path.at(2.0) == before
