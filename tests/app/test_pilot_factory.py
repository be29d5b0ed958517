"""Messages that the pilot requests for the sensors that the config declares."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from uav_recon.app import pilot_factory
from uav_recon.autopilot.mavlink.tlog import NoLog
from uav_recon.clock import ManualClock
from uav_recon.config import Config, load, parse

FLOWN = Path(__file__).parents[2] / "systemd" / "config.toml"
DISTANCE_SENSOR, OPTICAL_FLOW, OPTICAL_FLOW_RAD = 132, 100, 106


class NoBytes:
    def read(self) -> bytes:
        return b""

    def write(self, data: bytes) -> None:
        pass

    def wait(self, timeout_s: float) -> None:
        pass

    def close(self) -> None:
        pass


def config_of(autopilot: str, **sections: dict[str, Any]) -> Config:
    tree = load(FLOWN).model_dump(mode="json", exclude_none=True)
    tree["link"] |= {"autopilot": autopilot}
    for name, section in sections.items():
        tree[name] |= section
    return parse(tree, "config.toml")


def requested(autopilot: str, **sections: dict[str, Any]) -> dict[int, float]:
    config, clock = config_of(autopilot, **sections), ManualClock(0.0)
    allow_list = pilot_factory.make_allow_list_filter(config.link, clock)
    streams = pilot_factory.make_vehicle_link(config, NoBytes(), NoLog(), clock, allow_list).firmware.streams_hz
    assert len(dict(streams)) == len(streams), "each message once"
    return dict(streams)


@pytest.mark.parametrize(("autopilot", "message"), [("px4", OPTICAL_FLOW_RAD), ("ardupilot", OPTICAL_FLOW)])
def test_optical_flow_is_requested_only_if_it_is_enabled(autopilot: str, message: int) -> None:
    without, with_flow = requested(autopilot), requested(autopilot, flow={"enabled": True})
    assert not {message, DISTANCE_SENSOR} & set(without)
    assert set(with_flow) - set(without) == {message, DISTANCE_SENSOR}
    assert 20.0 <= with_flow[DISTANCE_SENSOR] <= with_flow[message]


def test_two_range_finders_share_one_message_at_the_higher_rate() -> None:
    both = requested("px4", flow={"enabled": True}, range_up={"fov_deg": 27.0})
    assert both[DISTANCE_SENSOR] == 20.0
    assert requested("px4", range_up={"fov_deg": 27.0})[DISTANCE_SENSOR] == 15.0


@pytest.mark.parametrize(("autopilot", "name"), [("px4", "EKF2_OF_CTRL"), ("ardupilot", "EK3_SRC2_VELXY")])
def test_the_parameters_of_optical_flow_are_checked_only_if_it_is_enabled(autopilot: str, name: str) -> None:
    checks = [
        pilot_factory.make_parameter_check(config_of(autopilot, flow={"enabled": enabled}))._wanted for enabled in (False, True)
    ]
    without, with_flow = ({one.name: one.value for one in wanted} for wanted in checks)
    assert name not in without
    assert with_flow[name] in (1.0, 5.0)
