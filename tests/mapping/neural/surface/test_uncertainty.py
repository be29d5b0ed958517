from __future__ import annotations

import numpy as np
import pytest

from uav_recon.mapping.neural.sdf_numba.losses import UNKNOWN
from uav_recon.mapping.neural.surface.uncertainty import (
    MAX_OFFSET_M,
    MIN_PAST_M,
    PRIOR_COLOUR_SIGMA,
    PRIOR_SIGMA_M,
    SHARP_SIGMA_M,
    ColourError,
    DepthInformation,
    MeasuredAgreement,
    NetworkColourSigma,
    ProductUncertainty,
)

LOW, HIGH = np.zeros(3), np.ones(3)
NODE = np.array([[0.48, 0.48, 0.48]], dtype=np.float32)  # a node of the 8 cm lattice
ONE = np.ones(1, dtype=np.float32)
SHARP = np.zeros(1, dtype=np.float32)


def test_information_adds_up_as_inverse_variances() -> None:
    depth = DepthInformation(LOW, HIGH)
    assert depth.at(NODE)[0] == pytest.approx(PRIOR_SIGMA_M)
    depth.add(NODE, ONE, 0.02 * ONE)
    depth.add(NODE, 0.5 * ONE, 0.01 * ONE)
    assert depth.at(NODE)[0] == pytest.approx(1.0 / np.sqrt(1 / 0.02**2 + 0.25 / 0.01**2 + 1.0), rel=1e-4)


def test_a_point_outside_the_box_is_ignored_and_unknown() -> None:
    depth = DepthInformation(LOW, HIGH)
    outside = np.array([[1.5, 0.5, 0.5]], dtype=np.float32)
    depth.add(outside, ONE, 0.01 * ONE)
    assert depth.at(outside)[0] == pytest.approx(PRIOR_SIGMA_M)
    assert depth.at(NODE)[0] == pytest.approx(PRIOR_SIGMA_M)


def test_colour_error_tends_to_the_mean_square() -> None:
    colour, at = ColourError(LOW, HIGH), np.array([[0.5, 0.5, 0.5]], dtype=np.float32)
    assert colour.at(at)[0] == pytest.approx(PRIOR_COLOUR_SIGMA)
    for _ in range(300):
        colour.add(at, np.array([0.05**2], dtype=np.float32))
    assert 0.05 < colour.at(at)[0] < 0.08
    known = colour.at(at)[0]
    colour.add(at, np.array([UNKNOWN]))
    assert colour.at(at)[0] == known


def test_the_product_is_higher_for_less_known_surface() -> None:
    depth, colour = DepthInformation(LOW, HIGH), ColourError(LOW, HIGH)
    both = ProductUncertainty(colour, depth)
    seen, unseen = NODE, np.array([[0.8, 0.8, 0.8]], dtype=np.float32)
    depth.add(seen, ONE, 0.01 * ONE)
    colour.add(seen, np.array([1e-4], dtype=np.float32))
    assert 0 < both.at(seen)[0] < both.at(unseen)[0]


def test_agreement_falls_with_the_root_of_the_count() -> None:
    once, often = MeasuredAgreement(LOW, HIGH), MeasuredAgreement(LOW, HIGH)
    node, up = np.array([[0.5, 0.5, 0.5]], dtype=np.float32), np.array([[0.0, 0.0, 1.0]], dtype=np.float32)
    once.add(node, up, SHARP)
    for _ in range(100):
        often.add(node, up, SHARP)
    on_the_plane = (MIN_PAST_M / MAX_OFFSET_M) ** 2
    assert once.at(node)[0] == pytest.approx(on_the_plane * 0.05 / np.sqrt(1.1), rel=1e-2)
    assert often.at(node)[0] == pytest.approx(on_the_plane * 0.05 / np.sqrt(100.1), rel=1e-2)


def test_ten_inaccurate_measurements_count_as_one_accurate_measurement() -> None:
    sharp, vague = MeasuredAgreement(LOW, HIGH), MeasuredAgreement(LOW, HIGH)
    node, up = np.array([[0.5, 0.5, 0.5]], dtype=np.float32), np.array([[0.0, 0.0, 1.0]], dtype=np.float32)
    sharp.add(node, up, SHARP)
    for _ in range(10):
        vague.add(node, up, SHARP + np.float32(3.0 * SHARP_SIGMA_M))
    assert vague.at(node)[0] == pytest.approx(sharp.at(node)[0], rel=1e-3)  # ten of a tenth


def test_uncertainty_grows_with_the_distance_from_the_measurements() -> None:
    measure, random = MeasuredAgreement(LOW, HIGH), np.random.default_rng(0)
    floor = np.column_stack([random.uniform(0.1, 0.9, (8000, 2)), np.full(8000, 0.42)]).astype(np.float32)
    measure.add(floor, np.tile(np.array([[0.0, 0.0, 1.0]], dtype=np.float32), (8000, 1)), np.zeros(8000, dtype=np.float32))
    past = np.array([0.0, 0.004, 0.01, 0.02, 0.03])
    beside = np.column_stack([np.full((5, 2), 0.5), 0.42 + past]).astype(np.float32)
    expected = np.square(past) + MIN_PAST_M**2  # all distances are equal, so this is their geometric mean
    assert np.allclose(measure.at(beside) / measure.at(beside[:1]), expected / expected[0], rtol=0.25)


def test_a_surface_that_follows_noise_is_less_certain_than_the_wall() -> None:
    measure, random = MeasuredAgreement(LOW, HIGH), np.random.default_rng(0)
    wall = np.column_stack([random.uniform(0.1, 0.9, (20000, 2)), np.full(20000, 0.42)]).astype(np.float32)
    wall[np.linalg.norm(wall[:, :2] - 0.5, axis=1) < 0.04, 2] += 0.01  # noise that is equal over a few pixels
    measure.add(wall, np.tile(np.array([[0.0, 0.0, 1.0]], dtype=np.float32), (20000, 1)), np.zeros(20000, dtype=np.float32))
    follows, smooth = measure.at(np.array([[0.5, 0.5, 0.4295], [0.25, 0.5, 0.42]], dtype=np.float32))
    assert follows > 8.0 * smooth


def test_a_corner_is_less_certain_than_a_wall_and_unmeasured_space_least_certain() -> None:
    measure = MeasuredAgreement(LOW, HIGH)
    wall, corner, nowhere = (np.array([[x, 0.5, 0.5]], dtype=np.float32) for x in (0.2, 0.5, 0.8))
    for normal in np.eye(3, dtype=np.float32):
        measure.add(wall, np.eye(3, dtype=np.float32)[:1], SHARP)
        measure.add(corner, normal[None], SHARP)
    on_the_plane = (MIN_PAST_M / MAX_OFFSET_M) ** 2
    assert measure.at(corner)[0] == pytest.approx(on_the_plane * (1.05 - 1 / np.sqrt(3)) / np.sqrt(3.1), rel=2e-2)
    assert 0 < measure.at(wall)[0] < measure.at(corner)[0] < measure.at(nowhere)[0]
    assert measure.at(nowhere)[0] == pytest.approx(1.05 / np.sqrt(0.1), rel=1e-2)


def test_the_papers_measure_is_the_output_of_the_network() -> None:
    assert NetworkColourSigma(lambda points: points[:, 0]).at(NODE)[0] == NODE[0, 0]
