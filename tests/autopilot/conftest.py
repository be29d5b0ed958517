"""What several files of this folder fly."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from flight_rig import Rig


@pytest.fixture(scope="session")
def both_flown_up() -> dict[str, Rig]:
    """Hovering with each firmware: to be copied, not flown."""
    from flight_rig import Rig
    from test_flight_ardupilot import CopterRig

    rigs = {"px4": Rig(), "ardupilot": CopterRig()}
    for rig in rigs.values():
        rig.airborne()
    return rigs
