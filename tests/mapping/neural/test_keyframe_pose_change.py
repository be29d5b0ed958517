from __future__ import annotations

import numpy as np
import pytest
from box_room import BASELINE_M, HIGH, LOW, NOISE_PX, distance_to_walls, tour

from uav_recon.config import MapperConfig
from uav_recon.mapping.neural.keyframes import keyframe_buffer
from uav_recon.mapping.neural.keyframes.keyframe_validation import RejectReason
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.mapping.neural.sdf_numba import adam
from uav_recon.mapping.neural.sdf_numba.sdf_field import NumbaSdfField
from uav_recon.types.camera import PosedFrame
from uav_recon.types.frames import Float32Array
from uav_recon.types.pose import Pose

VIEWS = tour(14, sigma_px=NOISE_PX)
RIGHT = [view.world_from_depth for view in VIEWS]
BEND_RAD = np.deg2rad(4.0)  # small, because a view that does not fit the map at all would be refused


def _bent(n: int) -> Pose:
    """Return the pose of a view in a map whose heading drifts during the flight."""
    turn = Pose.from_yaw(BEND_RAD * n / len(VIEWS), np.zeros(3))
    return turn @ RIGHT[n]


def _learn(poses: list[Pose]) -> NeuralMapper:
    trainer = NeuralMapper(MapperConfig(steps_per_view=15), LOW, HIGH, NOISE_PX, BASELINE_M)
    for view, pose in zip(VIEWS, poses, strict=False):
        assert trainer.add(PosedFrame(view.frame, pose))
        trainer.train(15)
    return trainer


def _error_m(trainer: NeuralMapper) -> float:
    return float(distance_to_walls(trainer.mesh(0.04).vertices_world).mean())


def test_after_a_repose_a_bent_map_is_as_accurate_as_one_learned_with_correct_poses() -> None:
    trainer = _learn([_bent(n) for n in range(len(VIEWS))])
    bent, right = _error_m(trainer), _learn(RIGHT)
    trainer.repose(dict(enumerate(RIGHT)), map_epoch=3)
    assert trainer.waiting == len(VIEWS)
    turns = 0
    while trainer.learn_waiting(2):
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


def test_a_view_added_while_others_wait_is_learned_after_them() -> None:
    trainer = _learn([_bent(n) for n in range(len(VIEWS))])
    trainer.repose(dict(enumerate(RIGHT)), map_epoch=1)
    trainer.learn_waiting(3)
    assert trainer.add(PosedFrame(VIEWS[0].frame, RIGHT[0], 1))
    assert trainer.waiting == len(VIEWS) - 3 + 1
    assert trainer.learn_waiting(100) == 0
    assert trainer.views == len(VIEWS) + 1


def test_views_without_a_pose_in_the_new_map_are_dropped_and_counted() -> None:
    trainer = _learn([_bent(n) for n in range(len(VIEWS))])
    outside = Pose.from_yaw(0.0, np.array([30.0, 0.0, 1.0]))
    given = {n: RIGHT[n] for n in range(len(VIEWS)) if n not in (0, 5)} | {7: outside, 99: RIGHT[0]}
    trainer.repose(given, map_epoch=2)
    assert trainer.kept == [n for n in range(len(VIEWS)) if n not in (0, 5, 7)]
    assert trainer.refusals.counts == {RejectReason.UNPLACED: 2, RejectReason.OUTSIDE: 1}
    assert trainer.learn_waiting(100) == 0
    np.testing.assert_allclose(trainer.positions(), [RIGHT[n].translation_m for n in trainer.kept], atol=0.02)
    assert distance_to_walls(trainer.surface().position_world).mean() < 0.012


def test_without_a_pose_for_any_view_the_map_is_empty_and_learning_continues() -> None:
    trainer = _learn(RIGHT)
    trainer.repose({}, map_epoch=2)
    assert trainer.refusals.counts == {RejectReason.UNPLACED: len(VIEWS)}
    assert (trainer.kept, trainer.waiting) == ([], 0)
    assert len(trainer.surface().position_world) == 0
    assert trainer.add(PosedFrame(VIEWS[0].frame, RIGHT[0], 2))
    trainer.train(20)
    assert trainer.kept == [len(VIEWS)]
    assert trainer.surface().map_epoch == 2


def test_a_view_of_another_map_epoch_is_refused() -> None:
    trainer = _learn(RIGHT)
    assert not trainer.add(PosedFrame(VIEWS[0].frame, RIGHT[0], 1))
    trainer.repose(dict(enumerate(RIGHT)), map_epoch=1)
    assert not trainer.add(VIEWS[0])
    assert trainer.refusals.counts == {RejectReason.EPOCH: 2}


@pytest.mark.parametrize("place", ["rays", "room"])
def test_when_memory_is_full_the_view_is_refused_and_the_map_is_unchanged(place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = _learn(RIGHT[:6])
    held, taken = trainer.positions(), trainer.views
    full = {"rays": (keyframe_buffer, "ray_records"), "room": (adam, "make_gradient")}[place]
    slots = trainer.field.capacity

    def refused(*_: object) -> None:
        raise MemoryError

    with monkeypatch.context() as patched:
        patched.setattr(*full, refused)
        patched.setattr(type(trainer.field), "cover", lambda *_: False)  # every view makes the grid grow
        for view in VIEWS[6:9]:
            assert not trainer.add(view)
    assert trainer.refusals.counts == {RejectReason.OUT_OF_MEMORY: 3}
    assert (trainer.views, trainer.waiting, trainer.field.capacity) == (taken, 0, slots)
    assert trainer.positions().shape == held.shape
    assert len(trainer.corrections()) == len(trainer.log_gains()) == taken
    assert trainer.add(VIEWS[6])  # memory is available again
    assert trainer.kept == list(range(7))
    assert np.isfinite(trainer.train(30))
    surface = trainer.surface()
    assert np.isfinite(surface.position_world).all()
    assert np.isfinite(surface.uncertainty).all()
    assert distance_to_walls(surface.position_world).mean() < 0.015


def test_a_grid_that_grew_only_in_part_when_memory_was_full_grows_later(monkeypatch: pytest.MonkeyPatch) -> None:
    """The optimiser has slots that the field lacks.

    A training step must not use a slot without moments.
    """
    trainer = _learn(RIGHT[:3])
    grow, capacity = NumbaSdfField.grow, trainer.field.capacity
    covers = iter([False])

    def refused(field: NumbaSdfField, slots: int) -> None:
        raise MemoryError

    cover = NumbaSdfField.cover
    monkeypatch.setattr(NumbaSdfField, "cover", lambda field, points: cover(field, points) and next(covers, True))
    monkeypatch.setattr(NumbaSdfField, "grow", refused)
    assert not trainer.add(VIEWS[3])
    assert np.isfinite(trainer.train(10))
    monkeypatch.setattr(NumbaSdfField, "grow", grow)
    covers = iter([False])
    assert trainer.add(VIEWS[3])
    assert trainer.field.capacity == 2 * capacity
    assert np.isfinite(trainer.train(10))


def test_when_memory_is_full_during_relearning_only_that_view_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = _learn(RIGHT[:5])
    trainer.repose(dict(enumerate(RIGHT)), map_epoch=1)
    trainer.learn_waiting(2)
    cover = NumbaSdfField.cover

    def once(field: NumbaSdfField, points: Float32Array) -> bool:
        monkeypatch.setattr(NumbaSdfField, "cover", cover)
        raise MemoryError

    monkeypatch.setattr(NumbaSdfField, "cover", once)
    assert trainer.learn_waiting(100) == 0
    assert trainer.kept == [0, 1, 3, 4]
    assert trainer.refusals.counts == {RejectReason.OUT_OF_MEMORY: 1}
    assert len(trainer.corrections()) == 4
    assert distance_to_walls(trainer.surface().position_world).mean() < 0.015
