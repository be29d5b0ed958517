"""Options of `uav-recon sim` and the config that they give, which the product accepts."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from sitl.apps.sim import _same_variant
from sitl.apps.sim_options import BUILT_IN_VIEWS, SCENE_VIEWS, SimOptions, UsageError
from sitl.apps.world_process import WorldOptions
from sitl.camera.camera_errors import DEFAULT_SCALE, CameraErrors
from sitl.scene.scene import Scene
from uav_recon.config import RangeUpConfig, load
from uav_recon.errors import UserError
from uav_recon.localization.calibration import kept_calibration
from uav_recon.motion.yaw_policy import AT_VIEWS, YawAlongPath, yaw_policy_of

SCENE = Scene(
    "box", np.zeros((3, 3), np.float32), np.array([[0, 1, 2]], np.int32), np.zeros((3, 3), np.uint8), 0.3,
    np.array([-1.0, -1.5, -0.1]), np.array([7.0, 1.5, 2.4]), np.zeros(3),
)  # fmt: skip


def test_the_defaults_are_the_built_in_room_with_a_tilted_d435i() -> None:
    options = SimOptions.parse()
    assert (options.scene, options.views, options.mount_pitch_down_deg) == (None, BUILT_IN_VIEWS, 15.0)
    assert (options.depth_noise, options.camera, options.variant, options.autopilot) == ("d435i", "d435i", "adaptive", "px4")
    assert options.out.is_absolute()
    assert SimOptions.parse(scene="room.ply").views == SCENE_VIEWS


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ({"mount": "fixed:61"}, "-60 to 60"),
        ({"mount": "swivel"}, "gimbal"),
        ({"range_up": 4.9}, "--range-up 4.9: want 5 to 60 degrees"),
        ({"range_up": math.nan}, "--range-up nan: want 5 to 60 degrees"),
        ({"mapper": "none"}, "neural, depth-only"),
        ({"mapper": "depth-only"}, "lockstep"),
        ({"mapper": "stand-in"}, "--mapper depth-only: needs --lockstep"),
        ({"mount": "fixed:"}, "--mount fixed:: want gimbal, or fixed:DEG"),
        ({"mount": "fixed"}, "--mount fixed: want gimbal, or fixed:DEG"),
        ({"mount": "fixed:nan"}, "-60 to 60"),
        ({"scene": ""}, "--scene is empty"),
        ({"start": "1,2,0,9999"}, "YAW is 9999; want -360 to 360 degrees"),
        ({"start": "1e300,2,0,0"}, "each -100000 to 100000"),
        ({"start": "nan,2,0,0"}, "each -100000 to 100000"),
        ({"fence": "0,0,0,1e300,1,1"}, "each -100000 to 100000"),
        ({"fence": "0,0,0,nan,1,1"}, "6 numbers X0,Y0,Z0,X1,Y1,Z1"),
        ({"radius": 0.01}, "0.05 to 0.6"),
        ({"blind_speed": 2.0}, "--blind-speed 2.0: want 0.1 to 1.2 m/s"),
        ({"camera": "d415"}, "d435i, wide"),
        ({"pose": "gps"}, "--pose gps: want one of stream, corrected, slam"),
        ({"camera_errors": "some"}, "--camera-errors some: want none, default or a factor of 0 to 2"),
        ({"camera_errors": "2.5"}, "none, default or a factor of 0 to 2"),
        ({"autopilot": "inav"}, "px4, ardupilot"),
        ({"uncertainty": "none"}, "agreement, paper, colour, information, product"),
        ({"variant": "best"}, "adaptive, merged, reconstruct, explore, explore-yaw, explore-then-refine, evpp, vpp"),
        ({"start": "1,2,3"}, "4 numbers"),
        ({"start": "1,2,3,inf"}, "4 numbers"),
        ({"fence": "0,0,0,1,1,0"}, "upper corner"),
    ],
)
def test_an_invalid_option_names_the_allowed_values(words: dict[str, str], named: str) -> None:
    with pytest.raises(UsageError, match=named) as failure:
        SimOptions.parse(**words)  # type: ignore[arg-type]
    assert failure.value.code == 2
    assert "\n" not in str(failure.value)


def test_a_folder_that_cannot_be_used_is_refused_before_the_scene_is_loaded(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "flown").mkdir()
    (tmp_path / "flown" / "timeline.jsonl").touch()
    for out, named in (
        ("file/x", "is not a folder"),
        ("file", "is not a folder"),
        ("flown", "already contains timeline.jsonl"),
    ):
        with pytest.raises(UsageError, match=named):
            SimOptions.parse(out=tmp_path / out).check_folder()
    SimOptions.parse(out=tmp_path / "a" / "b").check_folder()
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("name", ["config.toml", "keyframes", "mesh.ply", "report.json", "timeline.jsonl"])
def test_a_folder_with_something_that_a_flight_would_replace_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    with pytest.raises(UsageError, match=rf"--out .*: already contains {name}; name another folder") as failure:
        SimOptions.parse(out=tmp_path).check_folder()
    assert failure.value.code == 2
    (tmp_path / name).rename(tmp_path / "notes.txt")
    SimOptions.parse(out=tmp_path).check_folder()


def test_a_calibration_file_that_cannot_be_used_is_refused_before_the_flight(tmp_path: Path) -> None:
    notes, kept, new = tmp_path / "notes.txt", tmp_path / "kept.json", tmp_path / "new.json"
    notes.write_text("notes\n", encoding="ascii")
    kept_calibration.write(kept, "a camera", (("delay_s", 0.02, 0.004),))
    for file, named in (
        (notes, f"--calibration {notes}: not a calibration file"),
        (tmp_path / "no" / "c.json", f"--calibration {tmp_path / 'no' / 'c.json'}: folder {tmp_path / 'no'} does not exist"),
        (tmp_path, f"--calibration {tmp_path}: is a folder"),
        (Path("/dev/null"), "--calibration /dev/null: not a calibration file"),
        (notes / "c.json", f"--calibration {notes / 'c.json'}: folder {notes} does not exist"),
        (tmp_path / ("x" * 300), f"--calibration {tmp_path / ('x' * 300)}: cannot be read (File name too long)"),
    ):
        with pytest.raises(UserError) as failure:
            SimOptions.parse(calibration=file)
        assert (str(failure.value), failure.value.code) == (named, 2)
    for file in (kept, new):
        assert SimOptions.parse(calibration=file).calibration == file
    assert sorted(tmp_path.iterdir()) == [kept, notes]


def test_flights_that_begin_in_the_same_second_get_folders_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    same = SimOptions.parse()
    made = [same.with_own_folder().out for _ in range(3)]
    assert [folder.name for folder in made] == [same.out.name, f"{same.out.name}-2", f"{same.out.name}-3"]
    assert all(folder.is_dir() for folder in made)
    given = SimOptions.parse(out=tmp_path / "mine")
    assert given.with_own_folder() is given
    assert not given.out.exists()


def test_an_unusable_firmware_is_a_one_line_error(tmp_path: Path) -> None:
    plain, program = tmp_path / "readme", tmp_path / "arducopter"
    plain.write_text("", encoding="ascii")
    program.write_text("", encoding="ascii")
    program.chmod(0o755)
    for words, named in (
        ({"firmware": tmp_path / "none"}, "none: no such file"),
        ({"firmware": tmp_path}, "is a folder; want the binary"),
        ({"firmware": plain}, "readme: not executable"),
        ({"firmware": program, "lockstep": True}, "real time"),
        ({"firmware": program, "mount": "gimbal"}, "fixed:DEG"),
        ({"firmware": program, "port": 15000}, "14540"),
        ({"firmware": program, "range_up": 27.0}, "--range-up: needs the simulated autopilot"),
    ):
        with pytest.raises(UsageError, match=named) as failure:
            SimOptions.parse(**words)
        assert "\n" not in str(failure.value)


def test_the_world_gets_the_absolute_path_of_the_firmware(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("arducopter").write_text("", encoding="ascii")
    Path("arducopter").chmod(0o755)
    options = SimOptions.parse(firmware=Path("arducopter"), autopilot="ardupilot", port=15000)
    assert options.world(tmp_path).firmware == str(tmp_path / "arducopter")
    assert SimOptions.parse().world(tmp_path).firmware is None


def test_the_fence_of_the_product_is_the_box_of_the_scene(tmp_path: Path) -> None:
    config = SimOptions.parse(views=33, seed=5, variant="merged", port=15000, uncertainty="paper").config(SCENE, tmp_path)
    assert config.safety.fence_min_m == (-1.0, -1.5, -0.1)
    assert config.safety.fence_max_m == (7.0, 1.5, 2.4)
    assert config.localization.pad_heading_deg == pytest.approx(math.degrees(0.3)), "the fence has the axes of the scene"
    assert (config.mission.views, config.mapper.seed, config.planner.variant) == (33, 5, "merged")
    assert config.mapper.uncertainty == "paper"
    assert config.link.url == "udp:127.0.0.1:15000"
    assert config.camera.pitch_down_deg == 15.0
    assert config.runtime.folder == tmp_path


def test_the_pose_timeouts_add_up_to_less_than_the_landing_limit(tmp_path: Path) -> None:
    called_lost_s, mode_is_known_s, bar_s = 0.25, 0.25, 1.2
    assert called_lost_s + SimOptions.parse().config(SCENE, tmp_path).safety.pose_land_s + mode_is_known_s <= bar_s


def test_a_gimbal_is_set_in_world_and_product(tmp_path: Path) -> None:
    options = SimOptions.parse(mount="gimbal")
    assert options.world(tmp_path).mount_pitch_down_deg is None
    assert options.config(SCENE, tmp_path).camera.mount == "gimbal"


def test_a_range_finder_is_set_in_world_and_product(tmp_path: Path) -> None:
    options = SimOptions.parse(range_up=27.0)
    assert options.world(tmp_path).range_up_deg == 27.0
    assert options.config(SCENE, tmp_path).range_up == RangeUpConfig(fov_deg=27.0, position_body_m=(0.0, 0.0, 0.05))
    assert SimOptions.parse().world(tmp_path).range_up_deg is None
    assert SimOptions.parse().config(SCENE, tmp_path).range_up == RangeUpConfig()


def test_the_world_options_are_read_back_unchanged(tmp_path: Path) -> None:
    world = SimOptions.parse(scene="x.ply", start="1,2,0,90", fence="0,0,0,4,4,3", depth_noise="kinect").world(tmp_path)
    world.save(tmp_path / "world.json")
    back = WorldOptions.load(tmp_path / "world.json")
    assert (back.scene, tuple(back.start or ()), tuple(back.fence or ())) == ("x.ply", (1, 2, 0, 90), (0, 0, 0, 4, 4, 3))
    assert (back.depth_noise, back.stream) == ("kinect", str(tmp_path / "camera.stream"))


@pytest.mark.parametrize(("word", "scale"), [("none", 0.0), ("default", 1.0), ("0.5", 0.5), (None, DEFAULT_SCALE)])
def test_the_seed_draws_the_errors_of_the_camera(tmp_path: Path, word: str | None, scale: float) -> None:
    for mount, gimbal in (("gimbal", True), ("fixed:15", False)):
        SimOptions.parse(seed=7, mount=mount, camera_errors=word).world(tmp_path).save(tmp_path / "world.json")
        errors = WorldOptions.load(tmp_path / "world.json").drawn_camera_errors()
        assert errors == CameraErrors.drawn(7, scale, gimbal=gimbal)


@pytest.mark.parametrize(("radius_m", "clearance_m", "inset_m"), [(0.15, 0.35, 0.25), (0.20, 0.40, 0.30), (0.30, 0.50, 0.40)])
def test_clearance_and_inset_follow_the_radius(tmp_path: Path, radius_m: float, clearance_m: float, inset_m: float) -> None:
    options = SimOptions.parse(radius=radius_m)
    config = options.config(SCENE, tmp_path)
    assert config.planner.clearance_m == pytest.approx(clearance_m)
    assert config.safety.fence_inset_m == pytest.approx(inset_m)
    assert config.safety.vehicle_radius_m == options.world(tmp_path).radius_m == radius_m


def test_the_depth_only_mapper_flies_with_the_fast_camera_by_default() -> None:
    quick = SimOptions.parse(mapper="depth-only", lockstep=True)
    assert quick.camera == "fast"
    assert SimOptions.parse(mapper="stand-in", lockstep=True).mapper == "depth-only"
    assert SimOptions.parse(mapper="depth-only", lockstep=True, camera="d435i").camera == "d435i"
    assert (
        quick.config(SCENE, Path("/tmp")).camera.depth_noise_px
        == 0.5 * SimOptions.parse().config(SCENE, Path("/tmp")).camera.depth_noise_px
    )
    assert not quick.config(SCENE, Path("/tmp")).recording.rerun


@pytest.mark.parametrize(("mapper", "camera", "textured"), [
    ("neural", "d435i", True), ("depth-only", "d435i", True), ("depth-only", "small", True), ("depth-only", "fast", False),
])  # fmt: skip
def test_a_camera_with_colour_sees_a_scene_with_texture(mapper: str, camera: str, textured: bool) -> None:
    assert SimOptions.parse(mapper=mapper, camera=camera, lockstep=True).textured is textured


def test_a_blind_speed_below_the_maximum_yaws_into_the_direction_of_travel(tmp_path: Path) -> None:
    usual, careful = (SimOptions.parse(blind_speed=mps).config(SCENE, tmp_path) for mps in (1.2, 0.3))
    assert usual.safety.blind_speed_mps == usual.safety.max_speed_mps
    assert yaw_policy_of(usual) is AT_VIEWS
    gaze = yaw_policy_of(careful)
    assert isinstance(gaze, YawAlongPath)
    assert gaze.blind_speed_mps < careful.safety.blind_speed_mps == 0.3
    assert np.degrees(np.arctan(gaze.half_tan)) == pytest.approx([43.5, 29.0])


def test_vehicle_and_simulator_use_the_same_blind_speed(tmp_path: Path) -> None:
    vehicle = load(Path(__file__).parents[3] / "systemd" / "config.toml").safety
    flown = SimOptions.parse().config(SCENE, tmp_path).safety
    assert (vehicle.blind_speed_mps, vehicle.blind_memory_s) == (flown.blind_speed_mps, flown.blind_memory_s)
    assert flown.blind_speed_mps == 0.3


def test_the_mount_follows_from_the_room_unless_it_is_given() -> None:
    low, high = np.array([-1.7, -1.3, -0.1]), np.array([1.7, 1.3, 2.4])
    small = dataclasses.replace(SCENE, fence_min=low, fence_max=high)
    assert SimOptions.parse(mount="auto").with_mount_for(small).mount == "fixed:5"
    assert SimOptions.parse(mount="auto").with_mount_for(small).mount_pitch_down_deg == 5.0
    assert SimOptions.parse(mount="auto").with_mount_for(SCENE).mount == "fixed:10"
    assert SimOptions.parse(mount="fixed:15").with_mount_for(small).mount == "fixed:15"
    assert SimOptions.parse(mount="gimbal").with_mount_for(small).mount_pitch_down_deg is None


@pytest.mark.parametrize(
    ("variant", "mount", "equal"),
    [("explore-yaw", "fixed:15", True), ("explore-yaw", "gimbal", False), ("explore", "fixed:15", False)],
)
def test_a_variant_that_equals_another_one_with_this_mount_is_named(variant: str, mount: str, equal: bool) -> None:
    said = _same_variant(SimOptions.parse(variant=variant, mount=mount))
    assert bool(said) == equal
    assert not equal or "equals explore" in said
