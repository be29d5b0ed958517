from __future__ import annotations

import copy
import errno
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uav_recon.config import Config, ConfigError, SafetyConfig, Section, load, parse, replace_text, save

FLOWN = Path(__file__).parents[1] / "systemd" / "config.toml"


@pytest.fixture
def tree() -> dict[str, Any]:
    return load(FLOWN).model_dump(mode="json", exclude_none=True)


def _refused(tree: dict[str, Any]) -> str:
    with pytest.raises(ConfigError) as error:
        parse(tree, "config.toml")
    text = str(error.value)
    assert "\n" not in text
    assert text.startswith("config.toml: ")
    return text


@pytest.mark.parametrize(
    ("section", "key", "value", "wanted"),
    [
        ("safety", "max_speed_mps", 3.01, "safety.max_speed_mps: input should be less than or equal to 3 (got 3.01)"),
        ("safety", "max_speed_mps", 0.0, "safety.max_speed_mps: input should be greater than 0 (got 0.0)"),
        ("safety", "max_speed_mps", float("nan"), "safety.max_speed_mps: "),
        ("safety", "max_speed_mps", "fast", "safety.max_speed_mps: "),
        ("safety", "pose_timeout_s", 1.1, "safety.pose_timeout_s: "),
        ("safety", "fence_min_m", [0.0, 0.0], "safety.fence_min_m.2: field required"),
        ("camera", "pitch_down_deg", 61.0, "camera.pitch_down_deg: "),
        ("range_up", "fov_deg", 4.0, "range_up.fov_deg: input should be greater than 4 (got 4.0)"),
        ("range_up", "fov_deg", 60.1, "range_up.fov_deg: input should be less than or equal to 60 (got 60.1)"),
        ("range_up", "error_share", 0.0, "range_up.error_share: "),
        ("flow", "enabled", 1, "flow.enabled: want true or false (got 1)"),
        ("flow", "position_body_m", [0, 0, -1.01], "flow.position_body_m.2: input should be greater than or equal to"),
        ("camera", "depth_max_m", float("inf"), "camera.depth_max_m: "),
        ("camera", "source", "kinect", "camera.source: input should be 'stream', 'realsense', 'recorded' or 'ros2'"),
        ("link", "setpoint_rate_hz", 5.0, "link.setpoint_rate_hz: "),
        ("link", "vehicle_system", 233, "link.vehicle_system: input should be less than or equal to 232 (got 233)"),
        ("link", "vehicle_component", 0, "link.vehicle_component: input should be greater than or equal to 1 (got 0)"),
        ("link", "autopilot_uid", "none", "link.autopilot_uid: want a number in hex, greater than 0 (got 'none')"),
        ("link", "gimbal_component", 256, "link.gimbal_component: input should be less than or equal to 255 (got 256)"),
        ("link", "url", "tcp:h:14540", "link.url: want udp:HOST:PORT or serial:DEVICE:BAUD (got 'tcp:h:14540')"),
        ("link", "url", "udp:127.0.0.1:99999", "link.url: want a port of 1 to 65535"),
        ("link", "url", "udp:127.0.0.1:0", "link.url: want a port of 1 to 65535"),
        ("link", "url", "udp:0.0.0.0:14540", "link.url: want one address"),
        ("link", "url", "serial:/dev/ttyS0:12345", "link.url: want one of 9600, 19200,"),
        ("link", "url", "serial:/dev/ttyS0:٩٦٠٠", "link.url: want udp:HOST:PORT or serial:DEVICE:BAUD"),
        ("link", "peer_host", "any", "link.peer_host: want four numbers of 0 to 255 with dots between them (got 'any')"),
        ("link", "peer_host", "999.999.999.999", "link.peer_host: want four numbers of 0 to 255 with dots between them"),
        ("link", "peer_host", "1.2.3.٤", "link.peer_host: want four numbers of 0 to 255 with dots between them"),
        ("safety", "max_speed_mps", True, "safety.max_speed_mps: want a number (got True)"),
        ("safety", "max_speed_mps", "1.0", "safety.max_speed_mps: want a number (got '1.0')"),
        ("safety", "fence_corners_m", [[True, 0.0]], "safety.fence_corners_m.0.0: want a number (got True)"),
        ("camera", "position_body_m", [100, 0, 0], "camera.position_body_m.0: input should be less than or equal to 1 (got"),
        ("camera", "position_body_m", [0, 0, "0"], "camera.position_body_m.2: want a number (got '0')"),
        ("range_up", "position_body_m", [0, 0, -1.01], "range_up.position_body_m.2: input should be greater than or equal to"),
        ("mapper", "seed", -1, "mapper.seed: input should be greater than or equal to 0 (got -1)"),
        ("mission", "views", "20", "mission.views: want an integer (got '20')"),
        ("mission", "views", True, "mission.views: want an integer (got True)"),
        ("mission", "views", 20.5, "mission.views: want an integer (got 20.5)"),
        pytest.param("mission", "views", 16**6000, "mission.views: ", id="many digits"),
        pytest.param("safety", "max_speed_mps", 16**6000, "safety.max_speed_mps: ", id="many digits of a float"),
        ("mission", "autostart", "true", "mission.autostart: want true or false (got 'true')"),
        ("mission", "a\nb", 1, "mission.'a\\nb': unknown key (got 1)"),
        ("planner", "clearance_m", 0.2, "planner.clearance_m: "),
        ("planner", "variant", "best", "planner.variant: input should be 'adaptive', 'merged', "),
        ("planner", "preset", "mine", "planner.preset: input should be 'auto', 'bhxhp', 'rosser' or 'convoy'"),
        ("planner", "worth_share", 1.1, "planner.worth_share: "),
        ("mapper", "uncertainty", "best", "mapper.uncertainty: input should be 'agreement', 'paper', 'colour', '"),
        ("mission", "views", 3, "mission.views: "),
        ("mission", "speed", 1.0, "mission.speed: unknown key (got 1.0)"),
        ("motion", "speed_mps", 2.0, ": motion.speed_mps 2 must be at most safety.max_speed_mps, which is 1"),
        ("motion", "acceleration_mps2", 2.5, "must be at most safety.max_acceleration_mps2, which is 2"),
        ("motion", "yaw_rate_degps", 61.0, ": motion.yaw_rate_degps 61 must be at most safety.max_yaw_rate_degps, which is 60"),
        ("safety", "fence_corners_m", [[-3, -3], [3, 3], [3, -3], [-3, 3]], "the polygon crosses itself: side (-3.0, -3.0)"),
        ("safety", "fence_corners_m", [[-3, -3], [3, 3]], "fence_corners_m: a polygon of 2 corners is open"),
        ("safety", "fence_corners_m", [[1, -3], [3, -3], [3, 3]], "does not hold the take-off place (0, 0) with 0.3 m"),
        ("safety", "fence_corners_m", [[-3, -3], [4, -3], [0, 3]], "fence_corners_m: (4, -3) lies outside the box"),
        ("safety", "retreat_timeout_s", 0.4, "intent_timeout_s <= retreat_timeout_s <= land_timeout_s does not hold"),
        ("safety", "depth_land_s", 2.0, "depth_timeout_s <= depth_retreat_s <= depth_land_s does not hold"),
        ("safety", "blind_speed_mps", 1.1, "blind_speed_mps <= max_speed_mps does not hold"),
        ("safety", "retreat_speed_mps", 1.1, "retreat_speed_mps <= max_speed_mps does not hold"),
        ("safety", "fence_max_m", [3.5, 3.5, 0.2], "fence_max_m.z 0.2 must exceed fence_min_m.z -0.3 by twice the inset"),
    ],
)  # fmt: skip
def test_an_invalid_value_is_a_one_line_error_that_names_it(
    tree: dict[str, Any], section: str, key: str, value: Any, wanted: str
) -> None:
    tree.setdefault(section, {})[key] = value
    assert wanted in _refused(tree)


@pytest.mark.parametrize("name", list(SafetyConfig.model_fields))
def test_no_protective_number_has_a_default(tree: dict[str, Any], name: str) -> None:
    del tree["safety"][name]
    assert f"safety.{name}: field required" in _refused(tree)


@pytest.mark.parametrize("name", list(Config.model_fields))
def test_an_unknown_key_in_any_section_is_refused(tree: dict[str, Any], name: str) -> None:
    tree.setdefault(name, {})["no_such_key"] = 1
    assert f"{name}.no_such_key: unknown key" in _refused(tree)


def test_an_unknown_section_is_refused(tree: dict[str, Any]) -> None:
    tree["saftey"] = {}
    assert "saftey: unknown key" in _refused(tree)


@settings(max_examples=60, deadline=None)
@given(st.dictionaries(st.text(max_size=8), st.recursive(st.none() | st.floats() | st.text(max_size=5), st.lists), max_size=4))
def test_no_input_crashes_the_parser(extra: dict[str, Any]) -> None:
    with pytest.raises(ConfigError) as error:
        parse({"safety": {}, **extra}, "x")
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("content", "wanted"),
    [
        (b"[safety", "not TOML"),
        (b"a = 1\na = 2\n", "not TOML"),
        (b"\xff\xfe\x00", "not TOML"),
        (b"", "safety: field required"),
        (b"a = " + b"[" * 100_000, "nested too deeply"),
        (b"a = " + b"9" * 5000, "not TOML: a number has too many digits"),
    ],
)
def test_an_invalid_config_file_is_a_one_line_error(tmp_path: Path, content: bytes, wanted: str) -> None:
    path = tmp_path / "config.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=wanted) as error:
        load(path)
    assert str(error.value).startswith(f"{path}: ")
    assert "\n" not in str(error.value)


def test_a_key_of_two_lines_is_named_in_one(tree: dict[str, Any]) -> None:
    tree["a\nb"] = 1
    assert "config.toml: 'a\\nb': unknown key (got 1)" in _refused(tree)


def test_whole_numbers_and_lists_are_accepted_where_toml_gives_them(tree: dict[str, Any]) -> None:
    tree["safety"]["max_speed_mps"] = 2
    tree.setdefault("camera", {})["position_body_m"] = [0, -1, 1]
    config = parse(tree, "x")
    assert (config.safety.max_speed_mps, config.camera.position_body_m) == (2.0, (0.0, -1.0, 1.0))


def test_a_config_that_cannot_be_written_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "config.toml"
    path.write_text("old", encoding="ascii")
    monkeypatch.setattr(os, "fsync", _full)
    with pytest.raises(OSError, match="No space left on device"):
        save(load(FLOWN), path)
    assert path.read_text(encoding="ascii") == "old"
    assert list(tmp_path.iterdir()) == [path]


def _full(_: int) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_replaced_config_keeps_its_mode_and_its_link(tmp_path: Path) -> None:
    path, link = tmp_path / "config.toml", tmp_path / "link.toml"
    path.write_text("old", encoding="ascii")
    path.chmod(0o600)
    link.symlink_to(path.name)
    replace_text(link, "new")
    assert link.is_symlink()
    assert (path.read_text(encoding="utf-8"), path.stat().st_mode & 0o777) == ("new", 0o600)


def test_a_missing_file_is_a_one_line_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"absent\.toml: cannot be read \(No such file or directory\)"):
        load(tmp_path / "absent.toml")


def test_the_effective_config_can_be_flown_again(tmp_path: Path) -> None:
    flown = load(FLOWN)
    save(flown, tmp_path / "effective.toml")
    assert load(tmp_path / "effective.toml") == flown


def test_a_config_cannot_be_changed_in_flight(tree: dict[str, Any]) -> None:
    config = parse(copy.deepcopy(tree), "x")
    with pytest.raises(ValueError, match="frozen"):
        config.safety.max_speed_mps = 3.0


def test_every_key_has_its_line_of_documentation() -> None:
    source = (Path(__file__).parents[1] / "uav_recon" / "config.py").read_text()
    for kind in Section.__subclasses__():
        if kind is Config:
            continue
        for name in kind.model_fields:
            lines = [line for line in source.splitlines() if line.startswith(f"    {name}: ")]
            assert any("#" in line for line in lines), f"{kind.__name__}.{name} wants a word on what it does"
