from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from box_room import BASELINE_M, HIGH, LOW, NOISE_PX, WALL_RGB, tour

from uav_recon.config import MapperConfig
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.mapping.neural.sdf_torch.distributed import DeviceError, ProcessGroup, device_kind
from uav_recon.mapping.neural.sdf_torch.refiner import RefinePlan, Refiner
from uav_recon.mapping.neural.training_data import TrainingData
from uav_recon.types.frames import ByteArray, Float32Array

PLAN = RefinePlan(steps=240, voxel_m=0.03, rays=256, seed=0)


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


def gathered() -> TrainingData:
    """Return the training data of eight views of the box room."""
    trainer = NeuralMapper(MapperConfig(), LOW, HIGH, NOISE_PX, BASELINE_M)
    for view in tour(8):
        assert trainer.add(view)
    return trainer.training_data()


def refiner(device: str = "cpu", plan: RefinePlan = PLAN) -> Refiner:
    return Refiner(gathered(), plan, ProcessGroup(device))


def measured() -> tuple[Float32Array, Float32Array, ByteArray]:
    """Return measured points on walls, the inward normals there, and the walls' colours."""
    view = gathered().replay
    sigma = float(view.views.inverse_depth_sigma[0])
    points = view.rays(view.records(0)[:2000], *view.pose(0), sigma, view.views.stretch[0]).points[0].astype(np.float64)
    to_plane = np.abs(np.concatenate([points - LOW, points - HIGH], axis=1))
    wall = to_plane.argmin(axis=1)
    inwards = np.concatenate([np.eye(3), -np.eye(3)])[wall]
    return points.astype(np.float32), inwards.astype(np.float32), WALL_RGB[wall]


@pytest.fixture(scope="module")
def finished() -> Refiner:
    torch.set_num_threads(1)
    done = refiner()
    done.advance(PLAN.steps)
    return done


def test_learns_where_the_walls_are(finished: Refiner) -> None:
    assert finished.done
    points, inwards, rgb = measured()
    assert np.median(np.abs(finished.field.distance_m(points))) < 0.01
    before = finished.field.distance_m(points + np.float32(0.05) * inwards)
    assert np.median(np.abs(before - 0.05)) < 0.01
    apart = np.abs(finished.field.rgb(points)[:, None] * 255.0 - WALL_RGB).sum(axis=2)
    assert np.mean((WALL_RGB[apart.argmin(axis=1)] == rgb).all(axis=1)) > 0.8  # no other wall's colour is as near


def test_a_resumed_run_ends_in_the_same_state_as_an_uninterrupted_one() -> None:
    plan = dataclasses.replace(PLAN, steps=14)
    whole, broken = refiner(plan=plan), refiner(plan=plan)
    whole.advance(12)
    broken.advance(5)
    again = refiner(plan=plan)
    again.restore(broken.state())
    assert again.steps == 5
    again.advance(7)
    ended = again.state()
    for name, tensor in whole.state().items():
        assert torch.equal(tensor, ended[name]), name


def test_a_state_of_another_field_is_refused(finished: Refiner) -> None:
    with pytest.raises(ValueError, match="not of this field"):
        refiner(plan=dataclasses.replace(PLAN, voxel_m=0.05)).restore(finished.state())


def test_devices_are_named() -> None:
    assert device_kind("cpu") == "cpu"
    with pytest.raises(DeviceError, match="gpu: want auto, cpu, cuda"):
        device_kind("gpu")


def test_an_available_gpu_is_used_unless_the_cpu_is_requested(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert [device_kind(name) for name in ("auto", "cuda", "cpu")] == ["cuda", "cuda", "cpu"]


def test_without_a_gpu_cuda_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert device_kind("auto") == "cpu"
    with pytest.raises(DeviceError, match="torch sees no GPU"):
        device_kind("cuda")


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="torch sees no GPU: the CUDA graph is not tested here")
def test_training_on_a_gpu_graph_matches_the_cpu() -> None:
    plan = dataclasses.replace(PLAN, steps=12)  # three eager steps, then a graph
    processor, gpu = refiner(plan=plan), refiner("cuda", plan)
    losses = np.array([(processor.advance(1), gpu.advance(1)) for _ in range(plan.steps)])
    np.testing.assert_allclose(losses[:, 1], losses[:, 0], rtol=1e-2)
    points = np.random.default_rng(0).uniform(LOW, HIGH, (2000, 3)).astype(np.float32)
    apart = np.abs(processor.field.distance_m(points) - gpu.field.distance_m(points))
    assert np.median(apart) < 1e-3
