"""Two faults in one flight: each from its own moment on, and held to the worse of the two reactions."""

from __future__ import annotations

import dataclasses
import math
import random
from typing import Any

import numpy as np
import pytest
from made_up_evidence import ONSET_S, evidence

from sitl.faults.flights.campaign import Campaign
from sitl.faults.flights.fault_options import FaultOptions
from sitl.faults.injectors.base import Capabilities, DepthFrame, InjectionContext
from sitl.faults.injectors.companion import Crash, Stall
from sitl.faults.injectors.delayed import Delayed
from sitl.faults.injectors.mavlink_link import PacketLoss
from sitl.faults.injectors.pose_stream import PoseSilence
from sitl.faults.soak import SOAKS
from sitl.faults.table.all_scenarios import PAIRS, SCENARIOS, TABLE
from sitl.faults.table.pairs import APART_S, PAIRED, REACTIONS
from sitl.faults.table.scenario import Scenario, judge
from sitl.world.pose_tracker import PoseRecord
from uav_recon.app.option_validation import UsageError

POSE = PoseRecord(10.0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.full(6, 1e-4), 100, 0)
PICTURE = DepthFrame(10.0, np.zeros((4, 6), np.uint16), None)


def injection_context() -> InjectionContext:
    world: Any = None
    return InjectionContext(world, random.Random(1), now_s=7.0)


def moments(scenario: Scenario, number: int) -> dict[str, float]:
    """When each fault of the pair's n-th flight begins, in seconds after the flight's moment, to a hundredth."""
    at = injection_context()
    for injector in scenario.injectors(number):
        for turn in range(int(APART_S * 100) + 1):
            at.now_s = turn / 100.0
            injector.turn(at, at.now_s)
    return at.notes


def test_until_its_moment_there_is_no_fault_and_then_it_is_told() -> None:
    at, silence = injection_context(), Delayed(PoseSilence(for_s=1.0), 0.5, "B1")
    silence.turn(at, 0.49)
    assert (len(silence.pose(0.49, POSE)), at.notes) == (1, {})
    silence.turn(at, 0.52)
    assert (silence.pose(0.52, POSE), at.notes) == ([], {"B1": 7.0})
    at.now_s = 8.0
    silence.turn(at, 1.51)
    assert (silence.pose(1.51, POSE), at.notes) == ([], {"B1": 7.0}), "a second of it, from when it began"
    assert len(silence.pose(1.53, POSE)) == 1


def test_whatever_a_fault_touches_it_touches_later() -> None:
    at = injection_context()
    lost, crash = Delayed(PacketLoss("both", 1.0), 0.5, "D3"), Delayed(Crash("pilot", back_s=0.2), 0.5, "A7")
    for injector in (lost, crash):
        injector.turn(at, 0.4)
    assert (lost.to_autopilot(0.4, b"a"), lost.to_product(0.4, b"b")) == ([(0.0, b"a")], [(0.0, b"b")])
    assert not crash.stalls(0.4, "pilot")
    assert not crash.restarts(9.0, "pilot")
    for injector in (lost, crash):
        injector.turn(at, 0.5)
    assert lost.to_autopilot(0.6, b"a") == lost.to_product(0.6, b"b") == []
    assert crash.stalls(0.69, "pilot")
    assert [crash.restarts(0.69, "pilot"), crash.restarts(0.71, "pilot"), crash.restarts(0.8, "pilot")] == [False, True, False]
    assert Delayed(Stall("mission"), 0.5, "A1").needs is Capabilities.STAGES
    dark = Delayed(next(iter(SCENARIOS["C1"].injectors(0))), 0.1, "C1")
    assert dark.depth(0.2, PICTURE) == [(0.0, PICTURE)]
    dark.turn(at, 0.2)
    assert dark.depth(0.3, PICTURE) == []


def test_a_fault_that_never_began_has_nothing_to_end() -> None:
    class Ended(PoseSilence):
        ends = 0

        def end(self, at: InjectionContext) -> None:
            self.ends += 1

    for turned_s, ends in ((0.4, 0), (0.6, 1)):
        injector = Ended()
        late = Delayed(injector, 0.5, "X")
        late.turn(injection_context(), turned_s)
        late.end(injection_context())
        assert injector.ends == ends


def test_ten_rows_make_forty_five_pairs_none_with_itself() -> None:
    assert [scenario.id for scenario in TABLE if scenario.id in PAIRED] == list(PAIRED)
    assert len({scenario.id for scenario in PAIRS}) == len(PAIRS) == 45
    assert all(len(set(scenario.id.split("+"))) == 2 for scenario in PAIRS)
    assert len(SCENARIOS) == len(TABLE) + len(SOAKS) + len(PAIRS), "no two of one name"


def test_a_pair_takes_the_stricter_moment_and_the_place_that_either_needs() -> None:
    assert (SCENARIOS["B4+E1"].onset.after_s, SCENARIOS["B4+E1"].onset.speed_mps) == ((2.0, 15.0), 0.4)
    assert SCENARIOS["A1+E5"].onset.speed_mps == 0.6
    assert (SCENARIOS["F2+G2"].arena, SCENARIOS["A1+F2"].arena, SCENARIOS["A1+B1"].arena) == ("pen", "pen", "hall")
    assert (SCENARIOS["E1+E5"].observe_s, SCENARIOS["A1+E5"].observe_s, SCENARIOS["B1+E5"].observe_s) == (12.0, 160.0, 60.0)


def test_a_pair_flies_no_longer_than_the_shorter_of_its_flights() -> None:
    assert SCENARIOS["A1+E5"].views == SCENARIOS["E5"].views < SCENARIOS["A1"].views


@pytest.mark.parametrize("name", ["A1+B1", "B4+D2", "C1+D2"])
def test_either_fault_may_come_first_and_the_other_follows_soon(name: str) -> None:
    begun = [moments(SCENARIOS[name], number) for number in range(12)]
    assert begun == [moments(SCENARIOS[name], number) for number in range(12)], "a flight can be flown again"
    first, second = name.split("+")
    apart_s = [moment[second] - moment[first] for moment in begun]
    assert min(apart_s) < -0.1 < 0.1 < max(apart_s)
    assert all(min(moment.values()) == 0.0 for moment in begun)


def test_the_worse_of_two_reactions_wins() -> None:
    """The flight of the evidence lands 10 s after the moment, and is down after 13."""
    late = evidence(notes={"A1": ONSET_S, "B1": ONSET_S + 9.0})
    scenario = SCENARIOS["A1+B1"]
    verdict = judge(scenario, late, [])
    assert dict(zip([limit.name for limit in scenario.limits], verdict.figures, strict=True)) == pytest.approx(
        {"setpoint gap": 1 / 30, "landing mode after B1": 1.0, "disarmed after B1": 4.0}, abs=0.05
    )
    assert verdict.passed(scenario, "px4")
    assert not judge(scenario, dataclasses.replace(late, notes={"A1": ONSET_S, "B1": ONSET_S + 8.0}), []).passed(
        scenario, "px4"
    )
    only = judge(scenario, dataclasses.replace(late, notes={"A1": ONSET_S}), [])
    assert math.isnan(only.figures[1])
    assert not only.passed(scenario, "px4"), "a fault that never came proves nothing"


def test_each_pair_is_held_to_what_its_worse_row_does_and_to_its_stream() -> None:
    for scenario in PAIRS:
        worse = next((name for name in REACTIONS if name in scenario.id.split("+")), None)
        names = [limit.name for limit in scenario.limits]
        assert names[0] == "setpoint gap"
        assert names[1:] == ([f"{limit.name} after {worse}" for limit in REACTIONS[worse]] if worse else []), scenario.id
        gentler = {"D2+E1": (1.3, 0.3)}.get(scenario.id)
        limits = [(limit.limit, limit.ardupilot) for limit in (REACTIONS[worse] if worse else ())]
        assert [(limit.limit, limit.ardupilot) for limit in scenario.limits[1:]] == ([gentler] if gentler else limits), (
            scenario.id
        )
        assert scenario.room.overshoot_m == (1.0 if scenario.id in ("B1+F2", "D2+F2") else 0.30), scenario.id
    assert [limit.name for limit in SCENARIOS["B1+E1"].limits] == ["setpoint gap", "stream ends after E1"], (
        "a pilot's hand beats all"
    )
    assert [limit.name for limit in SCENARIOS["C1+F2"].limits] == ["setpoint gap"]


def test_a_reaction_is_a_bar_of_its_own_row() -> None:
    for name, limits in REACTIONS.items():
        own = {limit.name: limit for limit in SCENARIOS[name].limits}
        for limit in limits:
            assert (limit.limit, limit.ardupilot, limit.at_least) == (
                own[limit.name].limit,
                own[limit.name].ardupilot,
                limit.at_least,
            )


def test_pairs_are_flown_by_their_rows_name_and_not_by_default() -> None:
    assert Campaign.of(FaultOptions(only="G10")).scenarios == PAIRS
    assert [scenario.id for scenario in Campaign.of(FaultOptions(only="B1+E5, A1")).scenarios] == ["A1", "B1+E5"]
    assert not set(Campaign.of(FaultOptions()).scenarios) & set(PAIRS)
    assert "--only G10" in SCENARIOS["G10"].why
    groups = Campaign.of(FaultOptions(only="G10", seeds=5)).groups()
    assert (len(groups), sum(map(len, groups))) == (2 * 5 * 4, 2 * 5 * 45), "hall and pen, long and short"
    with pytest.raises(UsageError, match=r"no scenario E1\+D8; .*faults --list` shows A1 to H10, and pairs such as A1\+B1"):
        Campaign.of(FaultOptions(only="E1+D8"))
    with pytest.raises(UsageError, match="G10: cannot run in real time"):
        Campaign.of(FaultOptions(only="G10", real_time=True))
