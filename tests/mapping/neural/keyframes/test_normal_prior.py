from __future__ import annotations

import dataclasses
import logging
from pathlib import Path

import numpy as np
import onnx
import pytest
from box_room import BASELINE_M, DEPTH_LENS, HIGH, LOW, NOISE_PX, RGB_FROM_DEPTH, look
from onnx import TensorProto, helper

from uav_recon.config import MapperConfig
from uav_recon.mapping.neural.keyframes.normal_prior import NormalPrior, PriorError, open_prior
from uav_recon.mapping.neural.keyframes.ray_records import NORMAL_UNIT, ray_records
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.mapping.neural.worker.mapper_client import ProcessMapper
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame
from uav_recon.types.frames import AnyArray, FloatArray
from uav_recon.types.pose import Pose

H, W = 60, 106


def _save(path: Path, nodes: list[onnx.NodeProto], values: dict[str, AnyArray], inputs: list[object], outputs: int) -> Path:
    initial = [onnx.numpy_helper.from_array(value, name) for name, value in values.items()]
    results = [helper.make_tensor_value_info(f"y{n}", TensorProto.FLOAT, None) for n in range(outputs)]
    shapes = [helper.make_tensor_value_info(f"x{n}", TensorProto.FLOAT, shape) for n, shape in enumerate(inputs)]
    graph = helper.make_graph(nodes, "test", shapes, results, initial)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path


def _linear(path: Path, matrix: FloatArray, shift: FloatArray, shape: object = (1, 3, H, W)) -> Path:
    """Save a network that computes y = matrix @ rgb + shift at every pixel.

    So the colours encode its output.
    """
    values = {"w": matrix.astype(np.float32)[:, :, None, None], "b": shift.astype(np.float32)}
    return _save(path, [helper.make_node("Conv", ["x0", "w", "b"], ["y0"])], values, [shape], 1)


def _wall(rgb: AnyArray) -> Frame:
    """Return a frame of a plane through (0, 0, 2) of the colour camera, in one colour.

    Its depth is sparse.
    """
    depth = np.full((H, W), np.nan, dtype=np.float32)
    depth[::3, ::3] = 2.0  # too sparse for a plane fit, so no ray has a normal
    return Frame(0.0, 0, depth, DEPTH_LENS, np.broadcast_to(rgb, (H, W, 3)).astype(np.uint8), DEPTH_LENS, RGB_FROM_DEPTH)


def _bare(frame: Frame) -> AnyArray:
    records = ray_records(frame, 0.003, 26_000, np.random.default_rng(0))[0].copy()
    records[:, 3:6] = 0
    return records


def test_normals_in_colours_become_normals_of_rays(tmp_path: Path) -> None:
    normal = np.array([0.28, -0.6, -0.7493])
    rgb = np.rint((normal + 1.0) / 2.0 * 255.0)
    signed = NormalPrior(_linear(tmp_path / "signed.onnx", 2.0 * np.eye(3), -np.ones(3)))
    encoded = NormalPrior(_linear(tmp_path / "encoded.onnx", np.eye(3), np.zeros(3), (1, 3, 32, 48)))
    free = NormalPrior(_linear(tmp_path / "free.onnx", 2.0 * np.eye(3), -np.ones(3), ("n", 3, "h", "w")))
    frame = _wall(rgb)
    turned = dataclasses.replace(frame, rgb_from_depth=Pose.from_rotation_vector(np.array([0.0, 0.2, 0.0]), np.zeros(3)))
    for prior in (signed, encoded, free):
        for seen in (frame, turned):
            records = _bare(seen)
            count = prior.fill(records, seen)
            assert 100 < count <= len(records)
            given = records[records[:, 3:6].any(axis=1), 3:6] * NORMAL_UNIT
            assert len(given) == count
            np.testing.assert_allclose(given, np.tile(normal @ seen.rgb_from_depth.rotation(), (count, 1)), atol=0.01)


def test_measured_normals_are_kept_and_a_network_that_contradicts_them_is_rejected(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    frame = _wall(np.array([128, 128, 0]))
    true = NormalPrior(_linear(tmp_path / "true.onnx", 2.0 * np.eye(3), -np.ones(3)))
    flipped = NormalPrior(_linear(tmp_path / "flipped.onnx", -2.0 * np.eye(3), np.ones(3)))
    records = _bare(frame)
    records[::2, 3:6] = np.rint(np.array([0.1, 0.0, -0.995]) / NORMAL_UNIT)
    before = records.copy()
    with caplog.at_level(logging.WARNING):
        assert flipped.fill(records, frame) == 0
    assert np.array_equal(records, before)
    assert "flipped.onnx: its normals are at a median of 174°" in caplog.text
    assert true.fill(records, frame) > 100
    assert np.array_equal(records[::2], before[::2])


@pytest.mark.parametrize("inverse", [False, True])
def test_relative_depth_becomes_normals(tmp_path: Path, inverse: bool) -> None:
    """A floor and a wall: the network returns 3 z + 1 or 0.4 / z - 0.1, encoded in the colours."""
    view = look((1.5, 1.2, 1.0), 0.0)
    frame, lens = view.frame, view.frame.depth_intrinsics
    z = frame.depth_m.astype(np.float64)
    answered = 1.0 / z if inverse else z / 8.0
    answered /= answered.max()
    rgb = np.stack([np.floor(answered * 255.0), np.floor(answered * 255.0 % 1.0 * 255.0), np.zeros_like(answered)], axis=-1)
    same = dataclasses.replace(frame, rgb=rgb.astype(np.uint8), rgb_intrinsics=lens, rgb_from_depth=Pose.identity())
    matrix = np.array([[3.0, 3.0 / 255.0, 0.0]])
    prior = NormalPrior(_linear(tmp_path / "depth.onnx", matrix, np.array([-0.1])))
    measured = ray_records(same, 0.003, 26_000, np.random.default_rng(0))[0].copy()
    known = measured[:, 3:6].any(axis=1)
    records = measured.copy()
    hidden = known & (np.arange(len(records)) % 3 > 0)
    records[hidden, 3:6] = 0
    assert prior.fill(records, same) >= 0.95 * hidden.sum()
    cosine = np.einsum("nc,nc->n", records[hidden, 3:6] * NORMAL_UNIT, measured[hidden, 3:6] * NORMAL_UNIT)
    assert np.median(cosine) > 0.98


def test_the_mapper_learns_with_a_model_from_its_config(tmp_path: Path) -> None:
    path = _linear(tmp_path / "normals.onnx", np.zeros((3, 3)), np.array([0.0, 0.0, -1.0]))
    normals = []
    for model in (None, path):
        mapper = NeuralMapper(MapperConfig(prior_model=model), LOW, HIGH, NOISE_PX, BASELINE_M)
        frame = _wall(np.zeros(3))
        pose = Pose.from_rotation_vector(np.array([0.0, np.pi / 2, 0.0]), np.array([0.5, 1.2, 1.0]))
        assert mapper.add(PosedFrame(frame, pose))
        assert np.isfinite(mapper.train(5))
        normals.append(mapper.view_arrays(0)["records"][:, 3:6].any(axis=1).mean())
    assert normals[0] == 0.0
    assert normals[1] > 0.5


def test_no_model_is_no_prior() -> None:
    assert open_prior(None) is None


def test_a_missing_file_is_named_at_the_start(tmp_path: Path) -> None:
    config = MapperConfig(prior_model=tmp_path / "absent.onnx")
    with pytest.raises(PriorError, match=r"^mapper\.prior_model .*absent\.onnx: no such file$"):
        NeuralMapper(config, LOW, HIGH, NOISE_PX, BASELINE_M)
    with pytest.raises(PriorError, match=r"absent\.onnx"):
        ProcessMapper(config, LOW, HIGH, NOISE_PX, BASELINE_M, tmp_path)


def test_a_file_that_is_no_model_is_named(tmp_path: Path) -> None:
    path = tmp_path / "text.onnx"
    for content in (b"", b"not a model", b"\x08\x08" + bytes(100)):
        path.write_bytes(content)
        with pytest.raises(PriorError, match=r"text\.onnx: not an ONNX model that runs here") as caught:
            NormalPrior(path)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("shape", [(1, 1, H, W), (2, 3, H, W), (3, H, W), (1, H, W, 3)])
def test_a_model_with_the_wrong_input_shape_is_named(tmp_path: Path, shape: tuple[int, ...]) -> None:
    path = _save(tmp_path / "odd.onnx", [helper.make_node("Identity", ["x0"], ["y0"])], {}, [shape], 1)
    with pytest.raises(PriorError, match=r"odd\.onnx: wants tensor\(float\) .*, not one tensor\(float\) \[1, 3, h, w\]"):
        NormalPrior(path)


def test_a_model_with_two_inputs_two_outputs_or_a_wrong_output_shape_is_named(tmp_path: Path) -> None:
    add = [helper.make_node("Add", ["x0", "x1"], ["y0"])]
    with pytest.raises(PriorError, match="wants tensor"):
        NormalPrior(_save(tmp_path / "two.onnx", add, {}, [(1, 3, H, W)] * 2, 1))
    both = [helper.make_node("Identity", ["x0"], ["y0"]), helper.make_node("Neg", ["x0"], ["y1"])]
    with pytest.raises(PriorError, match=r"gives float32 \[1, 3, 60, 106\], float32"):
        NormalPrior(_save(tmp_path / "answers.onnx", both, {}, [(1, 3, H, W)], 2))
    with pytest.raises(PriorError, match=r"gives float32 \[1, 2, 60, 106\], not one"):
        NormalPrior(_linear(tmp_path / "pair.onnx", np.zeros((2, 3)), np.zeros(2)))


def test_an_image_that_the_model_fails_on_gives_no_normals(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    nodes = [helper.make_node("Add", ["x0", "w"], ["y0"])]
    values = {"w": np.zeros((1, 3, 64, 64), dtype=np.float32)}  # symbolic shape, but the model accepts only 64 x 64
    prior = NormalPrior(_save(tmp_path / "stiff.onnx", nodes, values, [(1, 3, "h", "w")], 1))
    frame = _wall(np.zeros(3))
    assert prior.fill(_bare(frame), frame) == 0
    assert prior.refused == 1
    assert "stiff.onnx: fails on a picture of 106x60" in caplog.text


def test_an_output_that_is_not_finite_gives_no_normal(tmp_path: Path) -> None:
    frame = _wall(np.zeros(3))
    for rows in (3, 1):
        prior = NormalPrior(_linear(tmp_path / f"nan{rows}.onnx", np.zeros((rows, 3)), np.full(rows, np.nan)))
        records = _bare(frame)
        assert prior.fill(records, frame) == 0
        assert not records[:, 3:6].any()


def test_a_camera_that_sees_none_of_the_rays_gives_no_normal(tmp_path: Path) -> None:
    prior = NormalPrior(_linear(tmp_path / "n.onnx", np.zeros((3, 3)), np.array([0.0, 0.0, -1.0])))
    frame = _wall(np.zeros(3))
    behind = dataclasses.replace(frame, rgb_from_depth=Pose.from_rotation_vector(np.array([0.0, np.pi, 0.0]), np.zeros(3)))
    assert prior.fill(_bare(behind), behind) == 0
    narrow = dataclasses.replace(frame, rgb_intrinsics=Intrinsics(5000.0, 5000.0, -900.0, 0.0, W, H))
    assert prior.fill(_bare(narrow), narrow) == 0
