"""For all tests: a core for each process where they run side by side, and a vehicle in the air, flown up once for a module.

A shell's background job is started with SIGINT ignored, and so are its children: Ctrl-C would not reach those of the tests.
"""

from __future__ import annotations

import copy
import os
import signal
from typing import TYPE_CHECKING

import pytest

from sitl.apps.sweep_case import one_thread

if TYPE_CHECKING:
    from flight_rig import Rig

signal.signal(signal.SIGINT, signal.default_int_handler)
if "PYTEST_XDIST_WORKER" in os.environ:
    one_thread()  # two that compute on both cores would get in each other's way


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with slow tests first: one of them that came last would be waited for alone."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture(scope="module")
def flown_up() -> Rig:
    from flight_rig import Rig

    rig = Rig()
    rig.airborne()
    return rig


@pytest.fixture(scope="session")
def both_flown_up() -> dict[str, Rig]:
    """Hovering with each firmware: to be copied, not flown."""
    from flight_rig import Rig
    from test_pilot_flight_ardupilot import CopterRig

    rigs = {"px4": Rig(), "ardupilot": CopterRig()}
    for rig in rigs.values():
        rig.airborne()
    return rigs


@pytest.fixture
def hovering(flown_up: Rig) -> Rig:
    return copy.deepcopy(flown_up)
