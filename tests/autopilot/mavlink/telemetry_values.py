"""Telemetry of a test: frozen values of which single fields are replaced by name, whatever group they are in."""

from __future__ import annotations

import dataclasses
from typing import Any

from uav_recon.autopilot.mavlink.telemetry import Telemetry


def changed(t: Telemetry, **values: Any) -> Telemetry:
    """Return telemetry with other values. Each is named by its field in Telemetry or in one of its groups."""
    for name, value in values.items():
        t = dataclasses.replace(t, **_replacement(t, name, value))
    return t


def _replacement(t: Telemetry, name: str, value: Any) -> dict[str, Any]:
    if name in Telemetry.__slots__:
        return {name: value}
    (group,) = (field.name for field in dataclasses.fields(t) if name in getattr(type(getattr(t, field.name)), "__slots__", ()))
    return {group: dataclasses.replace(getattr(t, group), **{name: value})}
