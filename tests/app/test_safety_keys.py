"""Each key of [safety] changes the limit of its own name in guard, failsafe and pilot, and no other."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest

from uav_recon.app import pilot_factory, safety_limits
from uav_recon.config import Config, SafetyConfig, load

FLOWN = load(Path(__file__).parents[2] / "systemd" / "config.toml")
CHANGED = {  # a valid other value of each key
    "fence_min_m": (-2.9, -3.9, -0.4),
    "fence_max_m": (2.9, 3.9, 2.4),
    "fence_corners_m": ((-2.5, -3.0), (2.5, -3.0), (2.5, 3.0), (-2.5, 3.0)),
}
LIMIT_OF = {  # where the limit is not one number of the same name
    "fence_min_m": {"fence.plan", "fence.floor_m"},
    "fence_max_m": {"fence.plan", "fence.ceiling_m"},
    "fence_corners_m": {"fence.plan"},
    "fence_inset_m": {"fence.inset_m"},
    "max_yaw_rate_degps": {"max_yaw_rate_radps"},
}


def flat(values: object, prefix: str = "") -> dict[str, Any]:
    """Return the fields of a dataclass by dotted name; `margins.` is left out, its fields have names of their own."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(values):  # type: ignore[arg-type]
        value = getattr(values, field.name)
        if field.name in ("fence", "margins"):
            found |= flat(value, "fence." if field.name == "fence" else "")
        else:
            found[prefix + field.name] = value
    return found


def limits(config: Config) -> dict[str, Any]:
    """Return every protective number that guard, failsafe and pilot are built with."""
    seen = safety_limits.recently_seen_space(config)
    parts = (
        safety_limits.failsafe_timeouts(config),
        safety_limits.guard_bounds(config),
        safety_limits.envelope(config),
        pilot_factory.hull_geometry(config),
    )
    found: dict[str, Any] = {"blind_memory_s": seen.memory_s}
    for part in parts:
        for name, value in flat(part).items():
            assert found.get(name, value) == value, f"{name} has two values"
            found[name] = value
    return found


def changed(key: str) -> Config:
    value = getattr(FLOWN.safety, key)
    other = CHANGED[key] if key in CHANGED else 0.999 * value
    return FLOWN.model_copy(update={"safety": SafetyConfig.model_validate(FLOWN.safety.model_dump() | {key: other})})


@pytest.mark.parametrize("key", SafetyConfig.model_fields)
def test_a_safety_key_changes_exactly_its_own_limit(key: str) -> None:
    before, after = limits(FLOWN), limits(changed(key))
    assert {name for name in before if before[name] != after[name]} == LIMIT_OF.get(key, {key})
