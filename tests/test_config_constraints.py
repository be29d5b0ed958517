"""Constraints between config values.

Each constraint passes at its limit and is a one-line error beyond it.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from uav_recon.config import ConfigError, load, parse
from uav_recon.config_constraints import CONSTRAINTS, EXPLICIT_KEY_CONSTRAINTS

FLOWN = Path(__file__).parents[1] / "systemd" / "config.toml"
EDGE = "the edge of 30 million voxels from safety.fence_min_m to safety.fence_max_m with voxels.margin_m around"
BORDERS: tuple[tuple[str, str, float, float, str], ...] = (  # section, key, last valid value, first invalid value, limit
    ("motion", "speed_mps", 1.0, 1.01, "at most safety.max_speed_mps, which is 1"),
    ("motion", "tight_speed_mps", 1.0, 1.01, "at most safety.max_speed_mps, which is 1"),
    ("motion", "climb_mps", 1.0, 1.01, "at most safety.max_speed_mps, which is 1"),
    ("motion", "descent_mps", 1.0, 1.01, "at most safety.max_speed_mps, which is 1"),
    ("motion", "acceleration_mps2", 2.0, 2.01, "at most safety.max_acceleration_mps2, which is 2"),
    ("motion", "yaw_rate_degps", 60.0, 60.1, "at most safety.max_yaw_rate_degps, which is 60"),
    ("safety", "vehicle_radius_m", 0.3, 0.301, "at most safety.fence_inset_m, which is 0.3"),
    ("voxels", "takeoff_radius_m", 0.2, 0.199, "at least safety.vehicle_radius_m, which is 0.2"),
    ("planner", "clearance_m", 0.35, 0.3499, "at least safety.vehicle_radius_m + safety.stop_clearance_m, which is 0.35"),
    ("voxels", "distance_cap_m", 0.4, 0.399, "at least planner.clearance_m, which is 0.4"),
    ("mission", "takeoff_height_m", 1.9, 1.91, "at most safety.fence_max_m.2 - safety.fence_inset_m, which is 1.9"),
    ("mission", "takeoff_height_m", 0.9, 0.89, "at least safety.fence_min_m.2 + safety.fence_inset_m, which is 0.9"),
    ("voxels", "resolution_m", 0.1, 0.0999, f"at least {EDGE}, which is 0.1"),
    ("camera", "depth_min_m", 5.99, 6.0, "less than camera.depth_max_m, which is 6"),
    ("camera", "depth_min_m", 4.99, 5.0, "less than voxels.max_range_m, which is 5"),
    ("localization", "frame_wait_s", 0.299, 0.3, "less than safety.depth_timeout_s, which is 0.3"),
    ("localization", "rate_hz", 25.0, 24.9, "at least 1 / safety.pose_timeout_s, which is 25"),
    ("planner", "shell_min_m", 1.49, 1.5, "less than planner.shell_max_m, which is 1.5"),
)
AROUND: dict[str, dict[str, dict[str, Any]]] = {
    "at least safety.vehicle_radius_m + safety.stop_clearance_m, which is 0.35": {
        "safety": {"stop_clearance_m": 0.15}
    },  # other values that must change so that this constraint is the one that fails
    "vehicle_radius_m": {"planner": {"clearance_m": 0.5}},
    "less than camera.depth_max_m, which is 6": {"voxels": {"max_range_m": 9.0}},
    "at least safety.fence_min_m.2 + safety.fence_inset_m, which is 0.9": {"safety": {"fence_min_m": [-3.5, -3.5, 0.6]}},
    "at least 1 / safety.pose_timeout_s, which is 25": {"safety": {"pose_timeout_s": 0.04}},
    f"at least {EDGE}, which is 0.1": {
        "safety": {"fence_min_m": [-50.0, -50.0, -0.2], "fence_max_m": [50.0, 50.0, 2.8], "fence_corners_m": []},
        "voxels": {"margin_m": 0.0},
    },
    "less than planner.shell_max_m, which is 1.5": {"planner": {"shell_max_m": 1.5}},
}


def tree(*around: str) -> dict[str, Any]:
    made = load(FLOWN).model_dump(mode="json", exclude_none=True)
    for name in around:
        for section, keys in AROUND.get(name, {}).items():
            made[section] |= keys
    return made


@pytest.mark.parametrize(("section", "key", "last", "first", "limit"), BORDERS)
def test_each_constraint_at_its_limit(section: str, key: str, last: float, first: float, limit: str) -> None:
    made = tree(key, limit)
    made[section][key] = last
    parse(made, "c")
    made[section][key] = first
    with pytest.raises(ConfigError) as caught:
        parse(made, "c")
    assert str(caught.value) == f"c: {section}.{key} {first:g} must be {limit}"


def test_every_constraint_is_tested_here() -> None:
    told = {(f"{section}.{key}", limit.partition(", which")[0]) for section, key, _, _, limit in BORDERS}
    assert told == {(one.key, f"{one.must_be} {one.limit}") for one in (*CONSTRAINTS, *EXPLICIT_KEY_CONSTRAINTS)}


def test_a_shell_with_one_end_from_the_preset_is_not_checked() -> None:
    made = {"safety": tree()["safety"], "planner": {"shell_max_m": 0.7, "clearance_m": 0.4}}
    assert math.isclose(parse(made, "c").planner.shell_max_m, 0.7)


@pytest.mark.parametrize(
    ("section", "key", "value", "words"),
    [
        ("link", "signing_key", "/etc/key", "link.signing_key: signs with link.autopilot ardupilot; PX4 has no signing before"),
        ("link", "url", "udp:10.41.1.1:14540", "link.peer_host: must name who may speak where link.url listens on a network"),
        ("camera", "source", "recorded", "camera.recording: must name a flight folder where camera.source is recorded"),
        ("localization", "source", "ros2", r"localization.source: must be stream \(the poses of the recording\) or slam"),
        ("recording", "live", True, "recording.live: true wants recording.rerun true"),
    ],
)
def test_a_setting_that_requires_another_is_refused_without_it(section: str, key: str, value: Any, words: str) -> None:
    made = tree()
    made["recording"]["rerun"] = False
    if section == "localization":
        made["camera"] |= {"source": "recorded", "recording": "/flight"}
    made[section][key] = value
    with pytest.raises(ConfigError, match=f"^c: {words}"):
        parse(made, "c")
    met: dict[str, dict[str, Any]] = {
        "signing_key": {"link": {"autopilot": "ardupilot"}},
        "url": {"link": {"peer_host": "10.41.1.2"}},
        "source": {"camera": {"recording": "/flight"} if section == "camera" else {"source": "stream"}},
        "live": {"recording": {"rerun": True}},
    }
    for name, keys in met[key].items():
        made[name] |= keys
    parse(made, "c")
