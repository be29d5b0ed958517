from __future__ import annotations

import numpy as np
import pytest
from box_world import FIXED, GIMBAL

from uav_recon.planning.camera_frustum import EDGE_MARGIN, CameraGeometry, aim, in_view, look_at, sight
from uav_recon.types.camera import body_from_camera
from uav_recon.types.pose import Pose


def test_the_frustum_is_that_of_an_optical_camera_on_a_body() -> None:
    rng = np.random.default_rng(0)
    lens = FIXED.lens(0.1, 4.5)
    seen = 0
    for _ in range(3000):
        yaw, pitch = rng.uniform(-np.pi, np.pi), rng.uniform(-1.0, 1.0)
        body, point = rng.uniform(-2, 2, 3), rng.uniform(-5, 5, 3)
        world_from_camera = Pose.from_yaw(yaw, body) @ body_from_camera(FIXED.position_body_m, pitch)
        optical = world_from_camera.inverse().apply(point)
        right, down = np.tan(FIXED.hfov_rad / 2) * EDGE_MARGIN, np.tan(FIXED.vfov_rad / 2) * EDGE_MARGIN
        expected = (
            optical[2] > 0
            and abs(optical[0]) <= right * optical[2]
            and abs(optical[1]) <= down * optical[2]
            and 0.3 <= np.linalg.norm(optical) <= 4.5
        )
        place = body * 10
        line = sight(lens, place, yaw, pitch)
        np.testing.assert_allclose(np.array(line[:3]) / 10, world_from_camera.translation_m, atol=1e-9)
        assert in_view(lens, line, point[0] * 10, point[1] * 10, point[2] * 10) == expected
        seen += bool(expected)
    assert seen > 100


def test_a_gimbal_centres_its_target_and_a_fixed_mount_keeps_its_tilt() -> None:
    target = np.array([12.0, -7.0, 5.0])
    for camera in (FIXED, GIMBAL):
        yaw, pitch = aim(camera.lens(0.1, 4.5), 1.0, 2.0, 13.0, target[0], target[1], target[2])
        pose = Pose.from_yaw(yaw, np.array([0.1, 0.2, 1.3])) @ body_from_camera(camera.position_body_m, pitch)
        optical = pose.inverse().apply(target * 0.1)
        assert abs(optical[0]) < 1e-9
        if camera is GIMBAL:
            assert abs(optical[1]) < 1e-9
        else:
            assert pitch == FIXED.pitch_min_rad


def test_look_at_equals_aim_followed_by_sight() -> None:
    rng = np.random.default_rng(1)
    for camera in (FIXED, GIMBAL):
        lens = camera.lens(0.1, 4.5)
        for place, target in zip(rng.uniform(0, 30, (200, 3)), rng.uniform(0, 30, (200, 3)), strict=True):
            yaw, pitch = aim(lens, *place, *target)
            np.testing.assert_allclose(look_at(lens, *place, *target), sight(lens, place, yaw, pitch), atol=1e-9)


def test_an_empty_pitch_range_raises_value_error() -> None:
    with pytest.raises(ValueError, match="pitch range"):
        CameraGeometry(1.0, 1.0, np.zeros(3), 0.2, 0.1, 4.5)
