"""The product's config and the options of the simulator that the options of a flight give."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from sitl.apps.flight_config import fitted_mount, flight_config, flow_section, mount_pitch_down_deg, world_options
from sitl.apps.sim import _same_variant
from sitl.apps.sim_options import SimOptions
from sitl.apps.world_process import WorldOptions, set_flow_parameters
from sitl.autopilots.ardupilot.parameters import ArduPilotParameters
from sitl.autopilots.flow_parameters import flow_parameters
from sitl.autopilots.px4.parameters import Px4Parameters
from sitl.camera.camera_error_scale import DEFAULT_SCALE
from sitl.camera.camera_errors import CameraErrors
from sitl.scene.scene import Scene
from uav_recon.config import Config, MissionConfig, RangeUpConfig, load
from uav_recon.motion.yaw_policy import AT_VIEWS, YawAlongPath, yaw_policy_of

SCENE = Scene(
    "box", np.zeros((3, 3), np.float32), np.array([[0, 1, 2]], np.int32), np.zeros((3, 3), np.uint8), 0.3,
    np.array([-1.0, -1.5, -0.1]), np.array([7.0, 1.5, 2.4]), np.zeros(3),
)  # fmt: skip


def config_of(options: SimOptions, runtime: Path) -> Config:
    return flight_config(dataclasses.replace(options, out=runtime / "flight"), SCENE, runtime)


def world_of(options: SimOptions, runtime: Path) -> WorldOptions:
    return world_options(dataclasses.replace(options, out=runtime / "flight"), runtime)


def fitted(mount: str, scene: Scene) -> str:
    return fitted_mount(SimOptions(mount=mount, out=Path("/flight")), scene)


def test_half_the_noise_of_a_camera_with_half_the_pixels(tmp_path: Path) -> None:
    quick = config_of(SimOptions(mapper="depth-only", lockstep=True), tmp_path)
    assert quick.camera.depth_noise_px == 0.5 * config_of(SimOptions(), tmp_path).camera.depth_noise_px
    assert not quick.recording.rerun


def test_the_world_gets_the_absolute_path_of_the_firmware(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("arducopter").write_text("", encoding="ascii")
    Path("arducopter").chmod(0o755)
    options = SimOptions(firmware=Path("arducopter"), autopilot="ardupilot", port=15000)
    assert world_of(options, tmp_path).firmware == str(tmp_path / "arducopter")
    assert world_of(SimOptions(), tmp_path).firmware is None


def test_the_fence_of_the_product_is_the_box_of_the_scene(tmp_path: Path) -> None:
    config = config_of(SimOptions(views=33, seed=5, variant="merged", port=15000, uncertainty="paper"), tmp_path)
    assert config.safety.fence_min_m == (-1.0, -1.5, -0.1)
    assert config.safety.fence_max_m == (7.0, 1.5, 2.4)
    assert config.localization.pad_heading_deg == pytest.approx(math.degrees(0.3)), "the fence has the axes of the scene"
    assert (config.mission.views, config.mapper.seed, config.planner.variant) == (33, 5, "merged")
    assert config.mapper.uncertainty == "paper"
    assert config.link.url == "udp:127.0.0.1:15000"
    assert config.camera.pitch_down_deg == 10.0
    assert config.runtime.folder == tmp_path


def test_no_views_typed_leave_the_budget_of_the_product(tmp_path: Path) -> None:
    assert config_of(SimOptions(), tmp_path).mission.views == MissionConfig().views


def test_the_pose_timeouts_add_up_to_less_than_the_landing_limit(tmp_path: Path) -> None:
    called_lost_s, mode_is_known_s, bar_s = 0.25, 0.25, 1.2
    assert called_lost_s + config_of(SimOptions(), tmp_path).safety.pose_land_s + mode_is_known_s <= bar_s


def test_a_gimbal_is_set_in_world_and_product(tmp_path: Path) -> None:
    options = SimOptions(mount="gimbal")
    assert world_of(options, tmp_path).mount_pitch_down_deg is None
    assert config_of(options, tmp_path).camera.mount == "gimbal"


def test_a_range_finder_is_set_in_world_and_product(tmp_path: Path) -> None:
    options = SimOptions(range_up_deg=27.0)
    assert world_of(options, tmp_path).range_up_deg == 27.0
    assert config_of(options, tmp_path).range_up == RangeUpConfig(fov_deg=27.0, position_body_m=(0.0, 0.0, 0.05))
    assert world_of(SimOptions(), tmp_path).range_up_deg is None
    assert config_of(SimOptions(), tmp_path).range_up == RangeUpConfig()


def test_a_flow_module_is_set_in_the_world_and_in_a_section_of_the_product(tmp_path: Path) -> None:
    assert world_of(SimOptions(flow=True), tmp_path).flow
    assert not world_of(SimOptions(), tmp_path).flow
    section = {"enabled": True, "position_body_m": [0.03, -0.02, -0.03], "range_position_body_m": [0.03, 0.02, -0.03]}
    assert flow_section(True) == {"flow": section}
    assert flow_section(False) == {}


@pytest.mark.parametrize(("autopilot", "prefix"), [("px4", "EKF2_OF_POS_"), ("ardupilot", "FLOW_POS_")])
def test_a_flow_module_is_set_in_the_parameters_of_the_autopilot(autopilot: str, prefix: str, tmp_path: Path) -> None:
    table = Px4Parameters.load() if autopilot == "px4" else ArduPilotParameters.load()
    before = {name: table[name] for name in table}
    set_flow_parameters(table, world_of(SimOptions(autopilot=autopilot), tmp_path))
    assert before == {name: table[name] for name in table}
    set_flow_parameters(table, world_of(SimOptions(autopilot=autopilot, flow=True), tmp_path))
    wanted = flow_parameters(autopilot)
    assert {name: table[name] for name in wanted} == pytest.approx(wanted)
    assert {name for name in table if table[name] != before[name]} <= set(wanted)
    assert [table[prefix + axis] for axis in "XYZ"] == pytest.approx([0.03, 0.02, 0.03]), "FRD"


def test_the_world_options_are_read_back_unchanged(tmp_path: Path) -> None:
    world = world_of(SimOptions(scene="x.ply", start="1,2,0,90", fence="0,0,0,4,4,3", depth_noise="kinect"), tmp_path)
    world.save(tmp_path / "world.json")
    back = WorldOptions.load(tmp_path / "world.json")
    assert (back.scene, tuple(back.start or ()), tuple(back.fence or ())) == ("x.ply", (1, 2, 0, 90), (0, 0, 0, 4, 4, 3))
    assert (back.depth_noise, back.stream) == ("kinect", str(tmp_path / "camera.stream"))


@pytest.mark.parametrize(("word", "scale"), [("none", 0.0), ("default", 1.0), ("0.5", 0.5), (None, DEFAULT_SCALE)])
def test_the_seed_draws_the_errors_of_the_camera(tmp_path: Path, word: str | None, scale: float) -> None:
    for mount, gimbal in (("gimbal", True), ("fixed:15", False)):
        world_of(SimOptions(seed=7, mount=mount, camera_errors=word), tmp_path).save(tmp_path / "world.json")
        errors = WorldOptions.load(tmp_path / "world.json").drawn_camera_errors()
        assert errors == CameraErrors.drawn(7, scale, gimbal=gimbal)


@pytest.mark.parametrize(("radius_m", "clearance_m", "inset_m"), [(0.15, 0.35, 0.25), (0.20, 0.40, 0.30), (0.30, 0.50, 0.40)])
def test_clearance_and_inset_follow_the_radius(tmp_path: Path, radius_m: float, clearance_m: float, inset_m: float) -> None:
    options = SimOptions(radius_m=radius_m)
    config = config_of(options, tmp_path)
    assert config.planner.clearance_m == pytest.approx(clearance_m)
    assert config.safety.fence_inset_m == pytest.approx(inset_m)
    assert config.safety.vehicle_radius_m == world_of(options, tmp_path).radius_m == radius_m


def test_a_blind_speed_below_the_maximum_yaws_into_the_direction_of_travel(tmp_path: Path) -> None:
    usual, careful = (config_of(SimOptions(blind_speed_mps=mps), tmp_path) for mps in (1.2, 0.3))
    assert usual.safety.blind_speed_mps == usual.safety.max_speed_mps
    assert yaw_policy_of(usual) is AT_VIEWS
    gaze = yaw_policy_of(careful)
    assert isinstance(gaze, YawAlongPath)
    assert gaze.blind_speed_mps < careful.safety.blind_speed_mps == 0.3
    assert np.degrees(np.arctan(gaze.half_tan)) == pytest.approx([43.5, 29.0])


def test_vehicle_and_simulator_use_the_same_blind_speed(tmp_path: Path) -> None:
    vehicle = load(Path(__file__).parents[3] / "systemd" / "config.toml").safety
    flown = config_of(SimOptions(), tmp_path).safety
    assert (vehicle.blind_speed_mps, vehicle.blind_memory_s) == (flown.blind_speed_mps, flown.blind_memory_s)
    assert flown.blind_speed_mps == 0.3


def test_the_mount_follows_from_the_room_unless_it_is_given() -> None:
    low, high = np.array([-1.7, -1.3, -0.1]), np.array([1.7, 1.3, 2.4])
    small = dataclasses.replace(SCENE, fence_min=low, fence_max=high)
    assert fitted("auto", small) == "fixed:5"
    assert mount_pitch_down_deg("fixed:5") == 5.0
    assert fitted("auto", SCENE) == "fixed:10"
    assert fitted("fixed:15", small) == "fixed:15"
    assert fitted("gimbal", small) == "gimbal"
    assert mount_pitch_down_deg("gimbal") is None
    assert mount_pitch_down_deg("auto") == 10.0


@pytest.mark.parametrize(
    ("variant", "mount", "equal"),
    [("explore-yaw", "fixed:15", True), ("explore-yaw", "gimbal", False), ("explore", "fixed:15", False)],
)
def test_a_variant_that_equals_another_one_with_this_mount_is_named(variant: str, mount: str, equal: bool) -> None:
    said = _same_variant(SimOptions(variant=variant, mount=mount))
    assert bool(said) == equal
    assert not equal or "equals explore" in said
