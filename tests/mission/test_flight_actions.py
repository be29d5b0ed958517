"""One action at a time flies, and each learns what interrupts it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from conductor_fixture import Desk, vehicle_state

from uav_recon.mission.flight_actions import FlightActions
from uav_recon.mission.state_machine import Phase
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

NOW_S = 100.0
VEHICLE = vehicle_state(NOW_S)


@pytest.fixture()
def desk(tmp_path: Path) -> Iterator[Desk]:
    desk = Desk(tmp_path)
    yield desk
    desk.journal.close()


@pytest.fixture()
def actions(desk: Desk) -> FlightActions:
    return desk.conductor._actions


@pytest.fixture()
def calls(actions: FlightActions, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The calls of the actions' parts, in order."""
    noted: list[str] = []
    for owner, part in (("executor", actions._executor), ("takeoff", actions.takeoff), ("survey", actions.survey),
                        ("return_home", actions.return_home)):  # fmt: skip
        for name in ("step", "interrupt", "begin_again", "stopped", "replan", "hold", "brake"):
            if hasattr(part, name):
                monkeypatch.setattr(part, name, lambda *_, call=f"{owner}.{name}", **__: noted.append(call))
    return noted


@pytest.mark.parametrize(
    ("phase", "blind", "mapped"),
    [
        (Phase.TAKEOFF, ["takeoff.step"], ["takeoff.step"]),
        (Phase.SURVEY, [], ["survey.step"]),
        (Phase.RETURN, [], ["return_home.step"]),
        (Phase.RETREAT, [], ["return_home.step"]),
        (Phase.HOLD, [], []),
    ],
)
def test_each_phase_has_its_action(
    desk: Desk, actions: FlightActions, calls: list[str], phase: Phase, blind: list[str], mapped: list[str]
) -> None:
    actions.step(phase, NOW_S, VEHICLE, None)
    assert calls == blind
    calls.clear()
    actions.step(phase, NOW_S, VEHICLE, desk.voxels.snapshot())
    assert calls == mapped


def test_only_on_the_way_home_it_may_be_lost(desk: Desk, actions: FlightActions, calls: list[str]) -> None:
    actions.return_home.lost = lost = Reason(ReasonCode.NO_WAY_BACK)
    voxels = desk.voxels.snapshot()
    phases = (Phase.TAKEOFF, Phase.SURVEY, Phase.RETURN, Phase.RETREAT)
    assert [actions.step(phase, NOW_S, VEHICLE, voxels) for phase in phases] == [None, None, lost, lost]


@pytest.mark.parametrize("phase", [Phase.SURVEY, Phase.HOLD, Phase.RETURN, Phase.RETREAT, Phase.LANDING])
def test_a_new_phase_interrupts_and_some_brake(actions: FlightActions, calls: list[str], phase: Phase) -> None:
    actions.enter(phase, NOW_S)
    brakes = phase in (Phase.HOLD, Phase.RETURN, Phase.RETREAT)
    assert calls == [*(["executor.brake"] if brakes else []), "survey.interrupt", "return_home.interrupt"]


@pytest.mark.parametrize("arrived", [False, True])
def test_a_landing_knows_if_it_began_at_home(actions: FlightActions, monkeypatch: pytest.MonkeyPatch, arrived: bool) -> None:
    monkeypatch.setattr(actions.return_home, "has_arrived", lambda now_s: arrived)
    actions.enter(Phase.RETURN, NOW_S)
    assert not actions.landed_at_home
    actions.enter(Phase.LANDING, NOW_S)
    assert actions.landed_at_home is arrived


def test_a_stop_holds_and_plans_again(actions: FlightActions, calls: list[str]) -> None:
    actions.stopped(NOW_S, VEHICLE, Reason(ReasonCode.REFUSED))
    assert calls == ["executor.hold", "survey.stopped", "return_home.replan"]


def test_a_new_map_holds_only_what_flies(actions: FlightActions, calls: list[str]) -> None:
    actions.begin_again(NOW_S, VEHICLE, 3)
    assert calls == ["survey.begin_again", "return_home.begin_again"]
    assert actions._executor.map_epoch == 3


def test_a_release_goes_on_in_hold_and_in_the_take_off(actions: FlightActions, calls: list[str]) -> None:
    for phase in (Phase.HOLD, Phase.TAKEOFF, Phase.SURVEY):
        actions.release(phase, NOW_S, VEHICLE)
    assert calls == ["executor.hold", "takeoff.begin_again"]
