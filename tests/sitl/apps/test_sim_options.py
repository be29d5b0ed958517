"""Options of `uav-recon sim`, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from sitl.apps.sim_options import SimOptions
from uav_recon.app.option_validation import UsageError


def test_the_defaults_are_the_built_in_room_with_a_tilted_d435i() -> None:
    options = SimOptions()
    assert (options.scene, options.views, options.mount) == (None, None, "auto")
    assert (options.depth_noise, options.camera_model, options.variant, options.autopilot) == (
        "d435i",
        "d435i",
        "adaptive",
        "px4",
    )


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ({"mount": "fixed:61"}, "-60 to 60"),
        ({"mount": "swivel"}, "gimbal"),
        ({"range_up_deg": 4.9}, "--range-up 4.9: want 5 to 60 degrees"),
        ({"range_up_deg": math.nan}, "--range-up nan: want 5 to 60 degrees"),
        ({"mapper": "none"}, "neural, depth-only"),
        ({"mapper": "depth-only"}, "lockstep"),
        ({"mount": "fixed:"}, "--mount fixed:: want gimbal, or fixed:DEG"),
        ({"mount": "fixed"}, "--mount fixed: want gimbal, or fixed:DEG"),
        ({"mount": "fixed:nan"}, "-60 to 60"),
        ({"scene": ""}, "--scene is empty"),
        ({"start": "1,2,0,9999"}, "YAW is 9999; want -360 to 360 degrees"),
        ({"start": "1e300,2,0,0"}, "each -100000 to 100000"),
        ({"start": "nan,2,0,0"}, "each -100000 to 100000"),
        ({"fence": "0,0,0,1e300,1,1"}, "each -100000 to 100000"),
        ({"fence": "0,0,0,nan,1,1"}, "6 numbers X0,Y0,Z0,X1,Y1,Z1"),
        ({"radius_m": 0.01}, "0.05 to 0.6"),
        ({"blind_speed_mps": 2.0}, "--blind-speed 2: want 0.1 to 1.2 m/s"),
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
        SimOptions(**words)  # type: ignore[arg-type]  # wrong on purpose
    assert failure.value.code == 2
    assert "\n" not in str(failure.value)


def test_an_unusable_firmware_is_a_one_line_error(tmp_path: Path) -> None:
    program = tmp_path / "arducopter"
    for words, named in (
        ({"firmware": program, "lockstep": True}, "real time"),
        ({"firmware": program, "mount": "gimbal"}, "fixed:DEG"),
        ({"firmware": program, "port": 15000}, "14540"),
        ({"firmware": program, "range_up_deg": 27.0}, "--range-up: needs the simulated autopilot"),
    ):
        with pytest.raises(UsageError, match=named) as failure:
            SimOptions(**words)  # type: ignore[arg-type]  # wrong on purpose
        assert "\n" not in str(failure.value)


def test_the_depth_only_mapper_flies_with_the_fast_camera_by_default() -> None:
    quick = SimOptions(mapper="depth-only", lockstep=True)
    assert quick.camera_model == "fast"
    assert SimOptions(mapper="depth-only", lockstep=True, camera="d435i").camera_model == "d435i"


@pytest.mark.parametrize(("mapper", "camera", "textured"), [
    ("neural", "d435i", True), ("depth-only", "d435i", True), ("depth-only", "small", True), ("depth-only", "fast", False),
])  # fmt: skip
def test_a_camera_with_colour_sees_a_scene_with_texture(mapper: str, camera: str, textured: bool) -> None:
    assert SimOptions(mapper=mapper, camera=camera, lockstep=True).textured is textured
