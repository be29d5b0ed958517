"""The operator of the campaign's flights, the faults that take him away, and what is measured of the answer."""

from __future__ import annotations

import math
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_up_evidence import evidence
from pymavlink.dialects.v20 import common as mavlink

from sitl.faults import reason_codes as codes
from sitl.faults.fault import Fault
from sitl.faults.fault_director import FaultDirector
from sitl.faults.flights.fault_flight import attended
from sitl.faults.injectors.base import ATTENDED, InjectionContext
from sitl.faults.injectors.operator_silence import (
    GroundStation,
    OperatorIntermittent,
    OperatorSilent,
    detour_on_return,
    return_delay,
    warnings,
    warns_after,
)
from sitl.faults.table.all_scenarios import SCENARIOS
from uav_recon import config as product_config

WARNED, RETURNS = (codes.OPERATOR_SILENT,), (codes.OPERATOR_LOST_RETURNING,)


class Line:
    """The proxy, as far as somebody can slip bytes into it."""

    def __init__(self) -> None:
        self.forged: list[bytes] = []

    def inject_to_product(self, data: bytes) -> None:
        self.forged.append(data)


def injection_context() -> InjectionContext:
    world: Any = None
    line: Any = Line()
    return InjectionContext(world, random.Random(1), proxy=line)


def test_who_has_gone_asks_no_more_and_his_last_question_is_noted() -> None:
    director = FaultDirector([Fault("D8", [OperatorSilent()])], 0)
    at = director.context = injection_context()
    at.now_s = 7.0
    assert director.attends()
    OperatorSilent().begin(at)
    at.now_s = 8.0
    assert not director.attends()
    assert at.notes == {ATTENDED: 7.0}


def test_who_is_heard_now_and_then_asks_once_in_ten_seconds() -> None:
    at, rare = injection_context(), OperatorIntermittent(10.0)
    asked = []
    for second in range(40):
        rare.turn(at, second + 0.4)
        asked.append(at.attends)
    assert [second for second, asks in enumerate(asked) if asks] == [0, 10, 20, 30]


def test_a_forged_ground_station_is_heard_once_a_second_and_looks_like_one() -> None:
    at, station = injection_context(), GroundStation()
    for turn in range(60 * 3):
        station.turn(at, turn / 60.0)
    proxy: Any = at.proxy
    (beat,) = mavlink.MAVLink(None).parse_buffer(proxy.forged[0])
    assert len(proxy.forged) == 3
    assert (beat.get_srcSystem(), beat.type, beat.autopilot) == (255, mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID)


def test_the_answer_counts_from_the_last_sign_of_life() -> None:
    e = evidence(notes={ATTENDED: 4.0}, reported=((3.0, RETURNS), (6.0, ()), (9.2, WARNED), (12.5, RETURNS)))
    assert warns_after(e) == pytest.approx(5.2)
    assert return_delay(e) == pytest.approx(8.5)
    assert warnings(e) == 3.0
    untold = evidence(notes={ATTENDED: 4.0}, reported=())
    assert return_delay(untold) == pytest.approx(11.0, abs=0.05), "a landing is an answer too"
    assert warns_after(untold) == return_delay(evidence(mode=("OFFBOARD",) * 600)) == math.inf


def test_a_way_that_leads_elsewhere_is_astray() -> None:
    """It flies 4 m along x until 10.5 s and lands there."""
    e = evidence(notes={ATTENDED: 4.0})
    assert detour_on_return(0.0)(e) == pytest.approx(4.0 - 0.5 * 2.75 - 0.5 * 2.75, abs=0.2)
    home = np.interp(e.stamp_s, [0.0, 5.0, 12.0], [3.0, 3.0, 0.0])
    straight = evidence(notes={ATTENDED: 4.0}, position_m=np.stack([home, 0.0 * home, 0.0 * home + 1.0], axis=1))
    assert detour_on_return(0.0)(straight) == pytest.approx(0.0, abs=1e-6)
    assert detour_on_return(0.0)(evidence()) == math.inf, "nobody ever attended"


def test_every_flight_in_lockstep_has_somebody_who_has_to_attend() -> None:
    flown = product_config.load(Path(__file__).parents[4] / "systemd" / "config.toml")
    alone = flown.model_copy(update={"mission": flown.mission.model_copy(update={"operator_timeout_s": None})})
    assert attended(alone).mission.operator_timeout_s == 30.0
    assert attended(alone) == flown, "nothing else is another"


def test_every_second_flight_of_d8_has_a_forger() -> None:
    assert [len(SCENARIOS["D8"].injectors(n)) for n in range(3)] == [1, 2, 1]
