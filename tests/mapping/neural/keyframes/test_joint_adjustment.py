"""Errors of a camera that its own views show: found, honest about what they are off by, and left alone if not shown."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from box_room import BASELINE_M, DEPTH_LENS, HIGH, LOW, NOISE_PX, distance_to_walls, tour, view_from

from uav_recon.config import MapperConfig
from uav_recon.mapping.neural.keyframes.estimated_errors import EstimatedErrors
from uav_recon.mapping.neural.keyframes.joint_adjustment import HELD_OUT, PRIOR_SIGMA, calibration_of
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.types.camera import PosedFrame
from uav_recon.types.camera_calibration import CameraCalibration
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

DELAY, SCALE, WIDTH = 0, 4, 5
ROTATION, OFFSET = slice(1, 4), slice(6, 9)
WRONG = np.array([0.02, 0.010, -0.012, 0.006, 0.014, -0.006, 0.004, -0.003, 0.002])
VIEWS = 36


def taken(
    errors: FloatArray,
    *,
    moving: bool = True,
    sigma_px: float = NOISE_PX,
    pose_sigma_m: float = 0.0,
    seed: int = 5,
    held_out: FloatArray | None = None,
) -> list[PosedFrame]:
    """Return views of a camera with errors (9,), at the poses that its configuration gives them.

    held_out: errors of the views that judge what the others estimate.
    """
    random = np.random.default_rng(seed)
    views, of_most = [], errors
    for n, view in enumerate(tour(VIEWS)):
        errors = held_out if held_out is not None and n % HELD_OUT == HELD_OUT - 1 else of_most
        wrong, longer = calibration_of(errors), 1 + errors[WIDTH]
        lens = dataclasses.replace(DEPTH_LENS, fx=DEPTH_LENS.fx * longer, fy=DEPTH_LENS.fy * longer)
        velocity_mps = random.uniform(-0.4, 0.4, 3) * moving
        rate_radps = random.uniform(-0.8, 0.8, 3) * np.array([0.2, 0.2, 1.0]) * moving
        given = CameraCalibration.none().motion(view.world_from_depth, velocity_mps, rate_radps)
        frame = view_from(wrong.pose(given), lens, n, sigma_px)
        reported = dataclasses.replace(
            frame.frame,
            stamp_s=0.5 * n,
            depth_m=frame.frame.depth_m * np.float32(1 + errors[SCALE]),
            depth_intrinsics=DEPTH_LENS,
        )
        shift = Pose.from_rotation_vector(pose_sigma_m * 0.4 * random.standard_normal(3), np.zeros(3))
        pose = Pose((shift @ view.world_from_depth).quat_wxyz, view.world_from_depth.translation_m)
        pose = Pose(pose.quat_wxyz, pose.translation_m + pose_sigma_m * random.standard_normal(3))
        views.append(PosedFrame(reported, pose, velocity_mps=velocity_mps, rate_radps=rate_radps))
    return views


def mapped(views: list[PosedFrame], *, align: bool = True) -> NeuralMapper:
    mapper = NeuralMapper(MapperConfig(), LOW, HIGH, NOISE_PX, BASELINE_M)
    mapper.align_views = align
    for view in views:
        assert mapper.add(view)
    return mapper


def found(views: list[PosedFrame]) -> EstimatedErrors:
    errors = mapped(views).camera_errors
    assert errors is not None
    return errors


@pytest.fixture(scope="module")
def wrong() -> EstimatedErrors:
    return found(taken(WRONG, pose_sigma_m=0.001))


def test_views_show_the_errors_of_their_camera(wrong: EstimatedErrors) -> None:
    off = wrong.value - WRONG
    assert abs(off[DELAY]) < 0.004
    assert np.linalg.norm(off[ROTATION]) < np.deg2rad(0.15)
    assert abs(off[SCALE]) < 0.005
    assert abs(off[WIDTH]) < 0.004


def test_the_deviations_contain_what_the_errors_are_off_by() -> None:
    """In units of the claimed deviation, over several draws of poses that are off by 5 mm and 0.1 degrees."""
    draws = [found(taken(WRONG, pose_sigma_m=0.005, seed=seed)) for seed in range(4)]
    off = np.stack([(draw.value - WRONG) / draw.sigma for draw in draws])
    assert np.abs(off).max() < 3.5
    assert np.sqrt(np.mean(off**2)) < 1.5
    assert (draws[0].sigma <= 1.001 * PRIOR_SIGMA).all()
    assert draws[0].sigma[SCALE] < 0.4 * PRIOR_SIGMA[SCALE]


def test_an_exact_camera_is_left_alone() -> None:
    errors = found(taken(np.zeros(9), pose_sigma_m=0.005))
    assert (np.abs(errors.value) < 3.5 * errors.sigma).all()
    assert abs(errors.value[SCALE]) < 0.006


def test_noise_does_not_shrink_the_map() -> None:
    """Residuals are smaller in a smaller map: without a remedy, noise alone makes depth look too large."""
    errors = found(taken(np.zeros(9), sigma_px=2 * NOISE_PX, pose_sigma_m=0.002))
    assert abs(errors.value[SCALE]) < 0.006


def test_a_camera_that_stood_still_shows_no_delay() -> None:
    still = WRONG.copy()
    still[DELAY] = 0.0
    errors = found(taken(still, moving=False))
    assert abs(errors.value[DELAY]) < 1e-6
    assert errors.sigma[DELAY] == pytest.approx(PRIOR_SIGMA[DELAY], rel=0.01)


def test_the_model_is_as_good_as_that_of_an_exact_camera() -> None:
    views, errors = taken(WRONG), []
    for align in (False, True):
        mapper = mapped(views, align=align)
        mapper.train(600)
        errors.append(distance_to_walls(mapper.mesh(0.04).vertices_world).mean())
    assert errors[1] < 0.35 * errors[0]
    assert errors[1] < 0.006


def test_a_keyframe_that_was_corrected_wrongly_gives_the_same_errors() -> None:
    applied = CameraCalibration(0.01, Pose.from_rotation_vector(np.array([0.01, 0.0, -0.01]), np.zeros(3)), -0.01)
    views = []
    for view in taken(WRONG):
        motion = CameraCalibration.none().motion(view.world_from_depth, view.velocity_mps, view.rate_radps)
        frame = dataclasses.replace(view.frame, depth_m=applied.true_depth_m(view.frame.depth_m))
        views.append(
            PosedFrame(
                frame, applied.pose(motion), calibration=applied, velocity_mps=view.velocity_mps, rate_radps=view.rate_radps
            )
        )
    assert found(views).value == pytest.approx(found(taken(WRONG)).value, abs=2e-4)


def test_views_held_out_confirm_a_correction_that_holds_for_them() -> None:
    mapper = mapped(taken(WRONG))
    mapper.training_data()
    assert mapper.camera_errors is not None
    assert abs(mapper.camera_errors.value[SCALE] - WRONG[SCALE]) < 0.003


def test_views_held_out_refuse_a_correction_that_is_wrong_for_them(monkeypatch: pytest.MonkeyPatch) -> None:
    larger = np.zeros(9)
    larger[SCALE] = 0.02
    mapper = mapped(taken(larger, held_out=-larger))
    before = mapper.camera_errors
    assert before is not None
    assert before.value[SCALE] > 0.004
    counted: list[int] = []
    monkeypatch.setattr(mapper, "_measure", counted.append)
    mapper.training_data()
    assert counted == list(range(VIEWS))  # where the surface is without the correction
    after = mapper.camera_errors
    assert after is not None
    assert np.array_equal(after.value, np.zeros(9))
    assert after.sigma == pytest.approx(PRIOR_SIGMA)


@pytest.mark.parametrize("seed", [1, 2])
def test_the_error_of_poses_that_drift_is_found(seed: int) -> None:
    """Corrections alone are too small: what neighbouring views share is hardly corrected."""
    random, kept, shift_m, views = np.random.default_rng(seed), np.exp(-0.5 / 5.0), 0.010 * np.ones(3), []
    for view in taken(np.zeros(9)):
        shift_m = kept * shift_m + 0.010 * np.sqrt(1.0 - kept**2) * random.standard_normal(3)
        place = view.world_from_depth
        views.append(dataclasses.replace(view, world_from_depth=Pose(place.quat_wxyz, place.translation_m + shift_m)))
    mapper = mapped(views)
    mapper.training_data()
    assert 0.007 < mapper._alignment.sigma[0] < 0.014
