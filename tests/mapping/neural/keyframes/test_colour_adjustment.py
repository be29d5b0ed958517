"""Errors of a colour imager that its own views show: found, left alone where not shown, and refused by views held out."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from box_room import BASELINE_M, DEPTH_LENS, HIGH, LOW, NOISE_PX, RGB_FROM_DEPTH, RGB_LENS, tour, view_from

from uav_recon.config import MapperConfig
from uav_recon.mapping.neural.keyframes.colour_adjustment import HELD_OUT, PRIOR_SIGMA, SYSTEMATIC_SIGMA
from uav_recon.mapping.neural.keyframes.estimated_errors import EstimatedErrors
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.types.camera import Intrinsics, PosedFrame
from uav_recon.types.camera_calibration import CameraMotion
from uav_recon.types.frames import ByteArray, FloatArray
from uav_recon.types.pose import Pose

DELAY, READOUT, ROTATION, WIDTH = 0, 1, slice(2, 5), 5
WRONG = np.array([0.012, 0.024, 0.004, -0.005, 0.003, 0.006, 0.0, 0.0, 0.0])
VIEWS = 30


def painting(points: FloatArray) -> ByteArray:
    """Return the colours (N, 3) of the walls at points (N, 3) on them."""
    x, y, z = (2 * np.pi * points / (0.5, 0.6, 0.45)).T
    waves = [np.sin(x + y) * np.cos(z), np.sin(1.3 * y - z), np.cos(0.8 * x + 1.1 * z)]
    return np.rint(128.0 + 80.0 * np.stack(waves, axis=-1)).astype(np.uint8)


def grey(points: FloatArray) -> ByteArray:
    return np.full((len(points), 3), 128, dtype=np.uint8)


def exposed(motion: CameraMotion, errors: FloatArray, wall: object = painting, lens: Intrinsics = RGB_LENS) -> ByteArray:
    """Return the image of a colour imager with errors (9,), whose depth imager moves, row by row."""
    true = dataclasses.replace(lens, fx=lens.fx * (1 + errors[WIDTH]), fy=lens.fy * (1 + errors[WIDTH]))
    depth_from_rgb = RGB_FROM_DEPTH.inverse() @ Pose.from_rotation_vector(errors[ROTATION], errors[6:])
    rgb = np.zeros((lens.height, lens.width, 3), dtype=np.uint8)
    for row, ray in enumerate(true.bearings()):
        dt = errors[DELAY] + errors[READOUT] * ((row + 0.5) / lens.height - 0.5)
        imager = motion.earlier(-dt) @ depth_from_rgb
        origin, along = imager.translation_m, ray @ imager.rotation().T
        with np.errstate(divide="ignore"):
            to_wall = np.concatenate([(LOW - origin) / along, (HIGH - origin) / along], axis=1)
        to_wall[to_wall <= 0] = np.inf
        rgb[row] = wall(origin + along * to_wall.min(axis=1)[:, None])  # type: ignore[operator]
    return rgb


def taken(errors: FloatArray, *, every: int = 1, wall: object = painting) -> list[PosedFrame]:
    """Return views of moving imagers; every: the first of each group of views has the errors, the others none."""
    random = np.random.default_rng(3)
    views = []
    for n, view in enumerate(tour(VIEWS)):
        velocity_mps, rate_radps = random.uniform(-0.4, 0.4, 3), random.uniform(-0.8, 0.8, 3) * np.array([0.2, 0.2, 1.0])
        frame = view_from(view.world_from_depth, DEPTH_LENS, n, NOISE_PX).frame
        here = errors if n % every == 0 else np.zeros(9)
        rgb = exposed(CameraMotion(view.world_from_depth, velocity_mps, rate_radps), here, wall)
        frame = dataclasses.replace(frame, rgb=rgb)
        views.append(PosedFrame(frame, view.world_from_depth, velocity_mps=velocity_mps, rate_radps=rate_radps))
    return views


def mapped(views: list[PosedFrame]) -> NeuralMapper:
    mapper = NeuralMapper(MapperConfig(), LOW, HIGH, NOISE_PX, BASELINE_M)
    for view in views:
        assert mapper.add(view)
    return mapper


def found(mapper: NeuralMapper) -> EstimatedErrors:
    errors = mapper.colour_errors
    assert errors is not None
    return errors


def colour_error(mapper: NeuralMapper) -> float:
    """Return the mean difference, in levels, of the colours of all rays and those of the walls where they end."""
    replay, off = mapper._replay, []
    for view in range(replay.count):
        records = replay.records(view)
        ends = replay.rays(records, *replay.pose(view), NOISE_PX, replay.views.stretch[view]).points[0]
        shown = records[:, 9] == 1
        off.append(np.abs(records[shown, 6:9] - painting(ends[shown].astype(np.float64)).astype(np.float64)).mean())
    return float(np.mean(off))


@pytest.fixture(scope="module")
def wrong() -> NeuralMapper:
    return mapped(taken(WRONG))


def test_views_show_the_errors_of_their_colour_imager(wrong: NeuralMapper) -> None:
    off = found(wrong).value - WRONG
    assert abs(off[DELAY]) < 0.0015
    assert abs(off[READOUT]) < 0.004
    assert np.rad2deg(np.linalg.norm(off[ROTATION])) < 0.1
    assert abs(off[WIDTH]) < 0.0015
    assert (np.abs(off) < 3.0 * found(wrong).sigma).all()


def test_rays_get_the_colours_of_the_walls_that_they_meet(wrong: NeuralMapper) -> None:
    exact, uncorrected = mapped(taken(np.zeros(9))), mapped(taken(WRONG)[:5])
    assert uncorrected.colour_errors is None
    floor = colour_error(exact)
    assert colour_error(wrong) < 1.3 * floor
    assert colour_error(uncorrected) > 1.5 * floor


def test_walls_of_one_colour_show_nothing() -> None:
    errors = found(mapped(taken(WRONG, wall=grey)))
    assert (np.abs(errors.value) < 0.1 * PRIOR_SIGMA).all()
    assert (errors.sigma > 0.9 * np.hypot(PRIOR_SIGMA, SYSTEMATIC_SIGMA)).all()


def test_views_held_out_refuse_a_correction_that_is_wrong_for_them() -> None:
    assert np.array_equal(found(mapped(taken(WRONG, every=HELD_OUT))).value, np.zeros(9))


def test_an_image_of_a_few_pixels_is_not_used() -> None:
    small = Intrinsics.from_fov(4, 2, np.deg2rad(69), np.deg2rad(42))
    black = np.zeros((2, 4, 3), dtype=np.uint8)
    views = [dataclasses.replace(v, frame=dataclasses.replace(v.frame, rgb=black, rgb_intrinsics=small)) for v in tour(8)]
    mapper = mapped(views)
    assert mapper.camera_errors is not None
    assert mapper.colour_errors is None
