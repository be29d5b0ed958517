from __future__ import annotations

import numpy as np
import pytest
from box_room import BASELINE_M, HIGH, LOW, NOISE_PX, distance_to_walls, tour

from uav_recon.config import MapperConfig
from uav_recon.mapping.neural.trainer import Trainer
from uav_recon.types.camera import PosedFrame
from uav_recon.types.pose import Pose

VIEWS = tour(14, sigma_px=NOISE_PX)
RIGHT = [view.world_from_depth for view in VIEWS]
BEND_RAD = np.deg2rad(4.0)  # a view that does not fit at all would be refused


def _bent(n: int) -> Pose:
    """A pose of a map whose heading drifts as the flight goes on."""
    turn = Pose.from_yaw(BEND_RAD * n / len(VIEWS), np.zeros(3))
    return turn @ RIGHT[n]


def _learn(poses: list[Pose]) -> Trainer:
    trainer = Trainer(MapperConfig(steps_per_view=15), LOW, HIGH, NOISE_PX, BASELINE_M)
    for view, pose in zip(VIEWS, poses, strict=True):
        assert trainer.add(PosedFrame(view.frame, pose))
        trainer.train(15)
    return trainer


def _error_m(trainer: Trainer) -> float:
    return float(distance_to_walls(trainer.mesh(0.04).vertices_world).mean())


def test_a_bent_map_is_as_good_after_a_repose_as_one_learned_with_the_right_poses() -> None:
    trainer = _learn([_bent(n) for n in range(len(VIEWS))])
    bent, right = _error_m(trainer), _learn(RIGHT)
    trainer.repose(RIGHT, map_epoch=3)
    assert trainer.waiting == len(VIEWS)
    turns = 0
    while trainer.relearn(2):
        turns += 1
    assert turns == len(VIEWS) // 2 - 1
    assert bent > 2.0 * _error_m(right)
    assert _error_m(trainer) == pytest.approx(_error_m(right), rel=0.15)
    surface = trainer.surface()
    assert surface.map_epoch == 3
    assert distance_to_walls(surface.position_world).mean() < 0.012
    assert trainer.uncertainty is trainer.uncertainties["agreement"]
    points = surface.position_world.astype(np.float32)
    reference = right.uncertainty.at(points)
    assert np.median(np.abs(trainer.uncertainty.at(points) / reference - 1.0)) < 0.1


def test_a_view_that_comes_while_others_wait_is_learned_after_them() -> None:
    trainer = _learn([_bent(n) for n in range(len(VIEWS))])
    trainer.repose(RIGHT, map_epoch=1)
    trainer.relearn(3)
    assert trainer.add(PosedFrame(VIEWS[0].frame, RIGHT[0], 1))
    assert trainer.waiting == len(VIEWS) - 3 + 1
    assert trainer.relearn(100) == 0
    assert trainer.views == len(VIEWS) + 1


def test_another_number_of_poses_is_an_error() -> None:
    trainer = Trainer(MapperConfig(), LOW, HIGH, NOISE_PX, BASELINE_M)
    with pytest.raises(ValueError, match="1 poses for 0 views"):
        trainer.repose(RIGHT[:1], map_epoch=1)
