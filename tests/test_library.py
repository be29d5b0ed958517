from __future__ import annotations

import dataclasses
import math
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import uav_recon
from uav_recon import Camera, Intrinsics, NeuralMapper, NothingLeft, OccupancyMapper, Pose, ViewPath, ViewPlanner
from uav_recon.app import library, mission_factory
from uav_recon.config import CameraConfig, Config, MotionConfig, PlannerConfig, VoxelConfig
from uav_recon.planning.free_space.flyable_space import FlyableSpace
from uav_recon.planning.tour.travel_time import YawWhileFlying
from uav_recon.types.camera import PosedFrame
from uav_recon.types.frames import ByteArray, FloatArray
from uav_recon.types.maps import FREE, OCCUPIED, UNKNOWN, GridSpec, VoxelMap
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
LOW_M, HIGH_M = np.zeros(3), np.array([4.0, 3.0, 2.5])
MIDDLE_M = np.array([2.0, 1.5, 1.2])
CAMERA = Camera.d435i()
DEPTH_M, RGB = np.full((240, 424), 1.0), np.zeros((240, 424, 3), dtype=np.uint8)


def room_depth(lens: Intrinsics, world_from_camera: Pose) -> FloatArray:
    """Depth along the optical axis in an empty room."""
    rays, origin = lens.bearings() @ world_from_camera.rotation().T, world_from_camera.translation_m
    depth: FloatArray = np.maximum((LOW_M - origin) / rays, (HIGH_M - origin) / rays).min(axis=-1)
    return depth


def views(count: int, camera: Camera = CAMERA) -> Iterator[tuple[FloatArray, ByteArray, Pose]]:
    """Depth, colour and pose from the middle of the room, all round."""
    for n in range(count):
        pose = camera.world_from_camera(Pose.from_yaw(2 * math.pi * n / count, MIDDLE_M))
        rgb = np.full((camera.rgb.height, camera.rgb.width, 3), 40 + 10 * n, dtype=np.uint8)
        yield room_depth(camera.depth, pose), rgb, pose


def in_child(code: str) -> str:
    """What Python prints that starts with these lines in a folder of somebody else."""
    child = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run([sys.executable, "-c", code], env=child, text=True, check=True, capture_output=True).stdout.strip()


def test_the_package_exports_what_it_lists_and_nothing_else() -> None:
    for name in uav_recon.__all__:
        assert getattr(uav_recon, name) is not None
        assert name in dir(uav_recon)
    missing = "Camara"
    with pytest.raises(AttributeError, match="no attribute 'Camara'"):
        getattr(uav_recon, missing)


def test_importing_the_package_loads_nothing() -> None:
    heavy = "{'numpy', 'numba', 'scipy', 'torch', 'typer', 'rich', 'pydantic'}"
    assert in_child(f"import sys, uav_recon; print(sorted({heavy} & set(sys.modules)))") == "[]"
    assert "numba" not in in_child("import sys; from uav_recon import Camera, Pose, Intrinsics; print(set(sys.modules))")


def test_the_version_is_that_of_the_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert uav_recon.__version__ == project["project"]["version"]
    assert not any(pattern.startswith("examples") for pattern in project["tool"]["setuptools"]["packages"]["find"]["include"])
    assert "examples" in project["tool"]["mypy"]["files"]


def test_the_short_constructors_have_the_defaults_of_the_configuration() -> None:
    wanted, motion = CameraConfig(), MotionConfig()
    assert (CAMERA.depth_min_m, CAMERA.depth_max_m) == (wanted.depth_min_m, wanted.depth_max_m)
    assert (CAMERA.depth_noise_px, CAMERA.baseline_m) == (wanted.depth_noise_px, wanted.baseline_m)
    assert tuple(CAMERA.position_body_m) == wanted.position_body_m
    assert CAMERA.pitch_down_rad == math.radians(wanted.pitch_down_deg)
    planner = ViewPlanner.for_box(LOW_M, HIGH_M, CAMERA)
    config = Config.model_construct(camera=wanted, voxels=VoxelConfig())
    geometry = mission_factory.camera_geometry(config)
    for name in ("hfov_rad", "vfov_rad", "pitch_min_rad", "pitch_max_rad", "range_m", "near_m", "surface_range_m"):
        assert getattr(planner.camera, name) == pytest.approx(getattr(geometry, name), rel=1e-12), name
    np.testing.assert_array_equal(planner.camera.position_body_m, geometry.position_body_m)
    usual = ViewPlanner(PlannerConfig(), LOW_M, HIGH_M, geometry, planner._travel_time_model)
    assert planner.config == usual.config
    assert planner._travel_time_model == YawWhileFlying(motion.speed_mps, math.radians(motion.yaw_rate_degps))


def test_a_look_round_maps_the_room() -> None:
    mapper = OccupancyMapper(CAMERA, LOW_M, HIGH_M)
    changed = sum(mapper.add_depth(depth_m, pose) for depth_m, _, pose in views(12))
    assert changed > 5000
    walls = mapper.points(OCCUPIED)
    assert len(walls) > 500
    off_m = np.abs(np.maximum(LOW_M - walls, walls - HIGH_M).max(axis=1))
    assert np.quantile(off_m, 0.99) < 0.16
    free = mapper.points(FREE)
    assert ((free > LOW_M) & (free < HIGH_M)).all()
    assert mapper.map is mapper.map
    assert mapper.explored_m3 == pytest.approx(1e-3 * in_box(mapper, LOW_M, HIGH_M), rel=1e-9)
    assert len(mapper.points(UNKNOWN)) + len(free) + len(walls) == mapper.map.state.size


def in_box(mapper: OccupancyMapper, low_m: FloatArray, high_m: FloatArray) -> int:
    known = np.concatenate([mapper.points(FREE), mapper.points(OCCUPIED)])
    return int(((known > low_m) & (known < high_m)).all(axis=1).sum())


def test_depth_and_keyframes_give_the_same_map() -> None:
    first, second = OccupancyMapper(CAMERA, LOW_M, HIGH_M), OccupancyMapper(CAMERA, LOW_M, HIGH_M)
    for depth_m, rgb, pose in views(3):
        assert first.add_depth(depth_m, pose) == second.add(CAMERA.keyframe(depth_m.astype(np.float32), rgb, pose))
    np.testing.assert_array_equal(first.map.state, second.map.state)


def test_the_planner_finds_views_until_the_room_is_known() -> None:
    mapper, planner = OccupancyMapper(CAMERA, LOW_M, HIGH_M), ViewPlanner.for_box(LOW_M, HIGH_M, CAMERA)
    body = Pose.from_yaw(0.0, MIDDLE_M)
    assert isinstance(planner.plan_views(mapper.map, body, 5), NothingLeft)  # nothing is known to be free
    mapper.declare_free(MIDDLE_M)
    planned, known_m3 = 0, 0.0
    for _ in range(100):
        pose = CAMERA.world_from_camera(body)
        mapper.add_depth(room_depth(CAMERA.depth, pose), pose)
        path = planner.plan_views(mapper.map, body, 1)
        if isinstance(path, NothingLeft):
            break
        planner.accept(path)
        (view,) = path.viewpoints
        planned, body = planned + 1, Pose.from_yaw(view.yaw_rad, view.position_world)
        assert mapper.explored_m3 >= known_m3
        known_m3 = mapper.explored_m3
    assert isinstance(path, NothingLeft)
    assert planned > 3
    assert known_m3 > 0.9 * np.prod(HIGH_M)
    assert no_path(planner.plan_views(mapper.map, body, 0)).code is ReasonCode.NO_VIEWS_LEFT


def no_path(answer: ViewPath | NothingLeft) -> Reason:
    assert isinstance(answer, NothingLeft)
    return answer.reason


def test_the_neural_mapper_learns_the_room() -> None:
    mapper = NeuralMapper.for_box(LOW_M, HIGH_M, CAMERA)
    assert mapper.train_for(1e9) == 0  # without a view there is nothing to learn
    for depth_m, rgb, pose in views(6):
        assert mapper.add(CAMERA.keyframe(depth_m, rgb, pose))
        mapper.train(5)
    before = mapper.steps
    assert mapper.train_for(0.0) == 0
    assert mapper.train_for(0.05) == mapper.steps - before > 0
    surface = mapper.surface()
    assert np.median(np.abs(np.maximum(LOW_M - surface.position_world, surface.position_world - HIGH_M).max(axis=1))) < 0.05
    assert len(mapper.mesh(0.08).faces) > 1000


def test_a_mesh_has_the_voxels_of_the_configuration_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []
    monkeypatch.setattr("uav_recon.mapping.neural.neural_mapper.triangle_mesh", lambda *a: asked.append(a[3]))
    mapper = NeuralMapper.for_box(LOW_M, HIGH_M, CAMERA, seed=3)
    mapper.mesh()
    mapper.mesh(0.05)
    assert asked == [0.02, 0.05]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_depth_outside_the_range_is_no_return(seed: int) -> None:
    rng = np.random.default_rng(seed)
    depth_m = rng.choice([0.0, -1.0, 0.299, 0.3, 1.0, 6.0, 6.001, np.inf, -np.inf, np.nan], (240, 424))
    frame = CAMERA.frame(depth_m, stamp_s=2.5)
    inside = (depth_m >= 0.3) & (depth_m <= 6.0)
    np.testing.assert_array_equal(np.isfinite(frame.depth_m), inside)
    np.testing.assert_array_equal(frame.depth_m[inside], depth_m[inside].astype(np.float32))
    assert frame.stamp_s == 2.5
    assert not frame.depth_m.flags.writeable
    assert not frame.rgb.any()


def test_a_frame_is_that_of_the_camera() -> None:
    lens = Intrinsics(100.0, 101.0, 31.5, 23.5, 64, 48)
    camera = Camera.registered(lens, depth_min_m=0.1, depth_max_m=9.0, depth_noise_px=0.5, baseline_m=0.1, pitch_down_rad=0.2)
    pose = Pose.from_yaw(0.3, np.array([1.0, 2.0, 3.0]))
    keyframe = camera.keyframe(np.full((48, 64), 8.0), np.full((48, 64, 3), 7, dtype=np.uint8), pose, stamp_s=4.0)
    assert (keyframe.frame.depth_intrinsics, keyframe.frame.rgb_intrinsics) == (lens, lens)
    assert keyframe.world_from_depth is pose
    assert (keyframe.frame.stamp_s, keyframe.map_epoch) == (4.0, 0)
    assert (keyframe.frame.rgb == 7).all()
    forward = camera.world_from_camera(Pose.identity()).rotation() @ np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(forward, [math.cos(0.2), 0.0, -math.sin(0.2)], atol=1e-12)


def any_of(value: object) -> Any:
    """A value that the signature does not allow."""
    return value


def registered(**changes: Any) -> Camera:
    numbers = {"fx": 100.0, "fy": 100.0, "cx": 31.5, "cy": 23.5, "width": 64, "height": 48}
    limits = {"depth_min_m": 0.1, "depth_max_m": 9.0, "depth_noise_px": 0.5, "baseline_m": 0.1}
    lens = Intrinsics(**{name: changes.get(name, value) for name, value in numbers.items()})
    return Camera.registered(lens, **{name: changes.get(name, value) for name, value in limits.items()})


def a_map() -> OccupancyMapper:
    return OccupancyMapper(CAMERA, LOW_M, HIGH_M)


def a_planner() -> ViewPlanner:
    return ViewPlanner.for_box(LOW_M, HIGH_M, CAMERA)


def cropped() -> PosedFrame:
    posed = CAMERA.keyframe(DEPTH_M, RGB, Pose.identity())
    return dataclasses.replace(posed, frame=dataclasses.replace(posed.frame, depth_m=posed.frame.depth_m[:-1]))


WRONG: list[tuple[Callable[[], object], str]] = [
    (lambda: CAMERA.frame(DEPTH_M[:-1]), r"depth_m: shape \(239, 424\), expected \(240, 424\)"),
    (lambda: CAMERA.frame(DEPTH_M.astype(np.uint16)), "depth_m: dtype uint16, expected float32 or float64 metres"),
    (lambda: CAMERA.frame(DEPTH_M, RGB[:, :, :1]), r"rgb: shape \(240, 424, 1\), expected \(240, 424, 3\)"),
    (lambda: CAMERA.frame(DEPTH_M, RGB / 255.0), "rgb: dtype float64, expected uint8"),
    (lambda: CAMERA.frame(DEPTH_M, stamp_s=math.nan), "stamp_s: nan, expected a finite number"),
    (lambda: CAMERA.keyframe(DEPTH_M, RGB, any_of(np.eye(4))), "world_from_camera: ndarray, expected Pose"),
    (lambda: CAMERA.world_from_camera(any_of(None)), "world_from_body: NoneType, expected Pose"),
    (lambda: Pose(np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, math.nan, 0.0])), "pose is not finite"),
    (lambda: Pose.from_matrix(np.full((4, 4), math.nan)), "pose is not finite"),
    (lambda: Camera.d435i(pitch_down_rad=15.0), "pitch_down_rad: 15.0, expected a finite number of -1.5708 to 1.5708"),
    (lambda: Camera.d435i(position_body_m=(0.0, 0.1)), r"position_body_m: shape \(2,\), expected \(3,\)"),
    (lambda: registered(fx=0.0), "depth.fx: 0.0, expected a finite number of 0.001 to"),
    (lambda: registered(width=1), "depth.width: 1, expected a finite number of 2 to"),
    (lambda: registered(depth_max_m=0.05), "depth_max_m: 0.05, expected more than depth_min_m 0.1"),
    (lambda: registered(baseline_m=math.inf), "baseline_m: inf, expected a finite number"),
    (lambda: registered(depth_noise_px=0.0), "depth_noise_px: 0.0, expected a finite number"),
    (lambda: OccupancyMapper(CAMERA, HIGH_M, LOW_M), r"box_max_m: \[0.0, 0.0, 0.0\], expected more than box_min_m"),
    (lambda: OccupancyMapper(CAMERA, LOW_M, (1.0, 1.0, math.nan)), r"box_max_m: \[1.0, 1.0, nan\], expected 3 finite numbers"),
    (lambda: OccupancyMapper(CAMERA, any_of("room"), HIGH_M), "box_min_m: 'room', expected 3 finite numbers"),
    (lambda: OccupancyMapper(any_of(RGB), LOW_M, HIGH_M), "camera: ndarray, expected Camera"),
    (lambda: OccupancyMapper(CAMERA, LOW_M, HIGH_M, 0.0), "resolution_m: 0.0, expected a finite number of 0.01 to 1"),
    (
        lambda: OccupancyMapper(CAMERA, LOW_M, 100 * HIGH_M, 0.05),
        r"resolution_m: 0.05 makes \d+ voxels, expected 67108864 at most",
    ),
    (lambda: OccupancyMapper(CAMERA, LOW_M, HIGH_M, max_range_m=-1.0), "max_range_m: -1.0, expected a finite number"),
    (lambda: a_map().add(any_of(DEPTH_M)), r"keyframe: ndarray, expected PosedFrame \(Camera.keyframe makes one\)"),
    (lambda: a_map().add(cropped()), r"depth_m: shape \(239, 424\), expected \(240, 424\)"),
    (lambda: a_map().add_depth(DEPTH_M, any_of(np.eye(4))), "world_from_camera: ndarray, expected Pose"),
    (lambda: a_map().declare_free((0.0, 0.0)), r"position_m: shape \(2,\), expected \(3,\)"),
    (lambda: a_map().declare_free(MIDDLE_M, math.nan), "radius_m: nan, expected a finite number"),
    (lambda: NeuralMapper.for_box(LOW_M, LOW_M, CAMERA), "box_max_m: .* expected more than box_min_m"),
    (lambda: NeuralMapper.for_box(LOW_M, HIGH_M, any_of(1)), "camera: int, expected Camera"),
    (
        lambda: NeuralMapper.for_box(LOW_M, HIGH_M, CAMERA).train_for(-1.0),
        "seconds: -1.0, expected a finite number of 0 or more",
    ),
    (lambda: ViewPlanner.for_box(LOW_M, HIGH_M, CAMERA, variant=any_of("best")), "variant: 'best', expected one of adaptive, "),
    (
        lambda: ViewPlanner.for_box(LOW_M, HIGH_M, CAMERA, clearance_m=0.1),
        "clearance_m: 0.1, expected a finite number of 0.3 to 1",
    ),
    (lambda: ViewPlanner.for_box(LOW_M, HIGH_M, CAMERA, speed_mps=0.0), "speed_mps: 0.0, expected a finite number"),
    (lambda: ViewPlanner.for_box(LOW_M, HIGH_M, CAMERA, yaw_rate_radps=0.0), "yaw_rate_radps: 0.0, expected a finite number"),
    (lambda: ViewPlanner.for_box(LOW_M, HIGH_M, CAMERA, max_range_m=0.0), "max_range_m: 0.0, expected a finite number"),
    (lambda: ViewPlanner.for_box(LOW_M, HIGH_M, any_of(None)), "camera: NoneType, expected Camera"),
    (lambda: a_planner().plan_views(any_of(a_map()), Pose.identity(), 3), "voxels: OccupancyMapper, expected VoxelMap"),
    (lambda: a_planner().plan_views(a_map().map, any_of(MIDDLE_M), 3), "world_from_body: ndarray, expected Pose"),
]


@pytest.mark.parametrize(("call", "text"), WRONG)
def test_a_wrong_value_is_named_in_one_line(call: Callable[[], object], text: str) -> None:
    with pytest.raises(ValueError, match=text) as raised:
        call()
    assert "\n" not in str(raised.value)


def test_warm_up_reports_each_stage(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    calls: list[object] = []
    for name in ("_occupancy", "_planner", "_neural"):
        monkeypatch.setattr(library, name, lambda name=name: calls.append(name))
    library.warm_up(progress=lambda *call: calls.append(call))
    assert calls == [
        ("occupancy map", 0, 3), "_occupancy", ("view planner", 1, 3), "_planner", ("neural mapper", 2, 3), "_neural",
        ("kernels are compiled", 3, 3),
    ]  # fmt: skip
    library.warm_up(progress=None)
    assert capfd.readouterr() == ("", "")
    uav_recon.warm_up()
    lines = capfd.readouterr().err.splitlines()
    assert lines[0] == "compiling kernels (1/3): occupancy map"
    assert lines[3:] == ["kernels are compiled"]


def test_on_a_terminal_warm_up_has_one_line(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    for done, stage in enumerate(("a", "b", "ready")):
        library.print_progress(stage, done, 2)
    shown = capfd.readouterr().err
    assert shown.count("\n") == 1
    assert shown.endswith("ready\n")


@pytest.mark.slow
def enter_another_region() -> None:
    """Move the vehicle from one of two separate regions of free space to the other."""
    grid, state = GridSpec(np.zeros(3), 0.1, (30, 20, 20)), np.full((30, 20, 20), FREE, dtype=np.uint8)
    state[15] = UNKNOWN
    space = FlyableSpace(grid, 0.1, np.zeros(3, dtype=np.int64), np.array(grid.shape))
    space.update(VoxelMap.whole(grid, state, np.where(state == FREE, 25, 0).astype(np.uint8), 0))
    for x_m in (0.8, 2.2):
        cells = space.locate_vehicle(np.array([x_m, 1.0, 1.0]))
        assert cells is not None
        assert space.reachable.reshape(-1)[cells[-1]]


def test_after_warm_up_nothing_is_left_to_compile() -> None:
    code = """
import sys
import uav_recon
from numba.core.dispatcher import Dispatcher
from test_library import *

def compiled():
    ours = [module for name, module in sys.modules.items() if name.startswith("uav_recon")]
    kernels = {value for module in ours for value in vars(module).values() if isinstance(value, Dispatcher)}
    return {(kernel.py_func.__qualname__, str(signature)) for kernel in kernels for signature in kernel.signatures}

uav_recon.warm_up(progress=None)
before = compiled()
test_a_look_round_maps_the_room()
test_the_planner_finds_views_until_the_room_is_known()
test_the_neural_mapper_learns_the_room()
enter_another_region()
assert len(before) > 50
print(sorted(compiled() - before))
"""
    assert in_child(f"import sys; sys.path.append({str(ROOT / 'tests')!r})\n{code}") == "[]"


@pytest.mark.slow
def test_the_snippets_of_the_page_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "library.md").read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) > 4
    names: dict[str, object] = {"views": list(views(6)), "print": lambda *_: None}
    for block in blocks:
        assert len(block.strip().splitlines()) <= 7, block
        exec(block, names)
    assert (tmp_path / "room.ply").stat().st_size > 1000
