from __future__ import annotations

import dataclasses

import numpy as np
from box_room import BASELINE_M, HIGH, LOW, NOISE_PX, tour

from uav_recon.config import MapperConfig
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.types.camera import PosedFrame
from uav_recon.types.frames import FloatArray

VIEWS = 28


def _learn(factor: FloatArray, steps: int = 0) -> NeuralMapper:
    """Return a mapper trained on the box room with altered exposures.

    The images are (rgb + 0.055) multiplied by factor (V, 3) and clipped.
    """
    trainer = NeuralMapper(MapperConfig(), LOW, HIGH, NOISE_PX, BASELINE_M)
    for view, gain in zip(tour(VIEWS), factor, strict=True):
        shown = np.clip((view.frame.rgb / 255.0 + 0.055) * gain - 0.055, 0.0, 1.0)
        frame = dataclasses.replace(view.frame, rgb=np.rint(255.0 * shown).astype(np.uint8))
        assert trainer.add(PosedFrame(frame, view.world_from_depth))
        trainer.train(steps)
    return trainer


def _sigma(trainer: NeuralMapper) -> FloatArray:
    points = trainer.all_surface_elements().position_world.astype(np.float32)
    return np.array([np.median(trainer.uncertainties[name].at(points)) for name in ("colour", "paper")])


def test_gains_undo_the_exposure_of_each_image_and_their_mean_is_one() -> None:
    log_factor = np.random.default_rng(3).uniform(-0.5, 0.0, (VIEWS, 3))  # nothing is clipped
    trainer = _learn(np.exp(log_factor))
    found = trainer.log_gains()
    assert np.abs(found.mean(axis=0)).max() < 1e-9
    wanted = log_factor.mean(axis=0) - log_factor
    assert np.std(found - wanted) < 0.25 * np.std(wanted)


def test_equal_exposures_are_left_alone() -> None:
    assert np.abs(_learn(np.ones((VIEWS, 3))).log_gains()).max() < 0.04


def test_exposures_do_not_change_the_colour_sigma() -> None:
    one = _sigma(_learn(np.ones((VIEWS, 3)), 6))
    factor = np.exp(np.random.default_rng(3).uniform(-0.29, 0.29, (VIEWS, 1))) * np.ones(3)
    many = _sigma(_learn(factor, 6))
    assert abs(many[0] / one[0] - 1.0) < 0.1


def test_a_clipped_colour_is_only_a_lower_bound_of_the_brightness() -> None:
    factor = np.ones((VIEWS, 3))
    factor[9] = 1.5  # four of six walls are clipped in at least one channel
    found = _learn(factor).log_gains()
    assert np.abs(found[9] - found.mean(axis=0) + np.log(1.5)).max() < 0.15
