"""Shared set-up of all tests: one core per process, and vehicles in the air.

In parallel runs, each process computes on one core. The vehicles take off once per module or session; tests copy them.
A background job of a shell starts with SIGINT ignored, and its children inherit that; the default handler is restored, so that
Ctrl-C reaches the children of the tests.
"""

from __future__ import annotations

import os
import signal
from typing import TYPE_CHECKING

import pytest
from flight_copy import flight_copy

from sitl.apps.sweep_case import one_thread

if TYPE_CHECKING:
    from flight_rig import Rig

signal.signal(signal.SIGINT, signal.default_int_handler)
if "PYTEST_XDIST_WORKER" in os.environ:
    one_thread()  # two processes that compute on both cores would slow each other down


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run files with slow tests first, so that none of them is left alone at the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture(scope="module")
def flown_up() -> Rig:
    from flight_rig import Rig

    rig = Rig()
    rig.take_off_and_hover()
    return rig


@pytest.fixture(scope="session")
def both_flown_up() -> dict[str, Rig]:
    """Return a hovering vehicle of each firmware; tests copy it and do not fly it."""
    from flight_rig import Rig
    from test_pilot_flight_ardupilot import CopterRig

    rigs = {"px4": Rig(), "ardupilot": CopterRig()}
    for rig in rigs.values():
        rig.take_off_and_hover()
    return rigs


@pytest.fixture
def hovering(flown_up: Rig) -> Rig:
    return flight_copy(flown_up)
