from __future__ import annotations

import numpy as np
import pytest
from box_room import BASELINE_M, HIGH, LOW, NOISE_PX, distance_to_walls, tour

from uav_recon.config import MapperConfig
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.types.camera import PosedFrame
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

VIEWS = 20


def _learn(align: bool, pose_sigma_m: float) -> tuple[NeuralMapper, FloatArray]:
    """Train on poses with errors; return the mapper and its position errors (V, 3)."""
    random = np.random.default_rng(2)
    trainer = NeuralMapper(MapperConfig(), LOW, HIGH, NOISE_PX, BASELINE_M)
    trainer.align_views = align
    views = tour(VIEWS, sigma_px=NOISE_PX)
    for view in views:
        turn = random.standard_normal(3) * pose_sigma_m * np.deg2rad(0.3) / 0.01
        shift = random.standard_normal(3) * pose_sigma_m
        true = view.world_from_depth
        given = Pose.from_rotation_vector(turn, np.zeros(3)).rotation() @ true.rotation()
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = given, true.translation_m + shift
        assert trainer.add(PosedFrame(view.frame, Pose.from_matrix(matrix)))
        trainer.train(15)
    trainer.polish(200)
    truth = np.stack([view.world_from_depth.translation_m for view in views])
    return trainer, trainer.positions() - truth


@pytest.fixture(scope="module")
def aligned() -> tuple[NeuralMapper, FloatArray]:
    return _learn(align=True, pose_sigma_m=0.015)


def test_alignment_reduces_pose_errors(aligned: tuple[NeuralMapper, FloatArray]) -> None:
    plain, before = _learn(align=False, pose_sigma_m=0.015)
    trainer, after = aligned
    apart = [np.linalg.norm(error - error.mean(axis=0), axis=1).mean() for error in (before, after)]
    assert apart[1] < 0.7 * apart[0]
    error = [distance_to_walls(t.mesh(0.04).vertices_world).mean() for t in (plain, trainer)]
    assert error[1] < 0.9 * error[0]


def test_the_map_as_a_whole_stays_where_the_given_poses_put_it(aligned: tuple[NeuralMapper, FloatArray]) -> None:
    trainer, _ = aligned
    common = np.abs(trainer.corrections()[:, :3].mean(axis=0)).max()
    assert common < 0.004  # the mean over time, which counts neighbours less, is what stays
    assert np.abs(trainer.corrections()[:, :3]).max() > 0.005


def test_exact_poses_are_left_alone() -> None:
    _, error = _learn(align=True, pose_sigma_m=0.0)
    assert np.linalg.norm(error, axis=1).mean() < 0.004
