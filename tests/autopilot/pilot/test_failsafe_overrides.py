"""Each row of the failsafe in flight: the pilot does its action, except for the commands that the row names, and a human."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import pytest
from flight_copy import flight_copy
from flight_rig import Rig
from guard_rooms import TIMEOUTS

from uav_recon.safety.failsafe import Failsafe
from uav_recon.safety.failsafe_precedence import (
    CONDITIONS,
    OUTSIDE_S,
    FailsafeAction,
    FailsafeInputs,
    Observation,
    Override,
)
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.trajectory import Goal
from uav_recon.types.vehicle import FlightPhase

LATER_S = 1e-3
OUT_X_M = 1.2
WATCHED_S = {FailsafeAction.HOLD: 2.0, FailsafeAction.RETREAT: 4.0, FailsafeAction.LAND: 2.0}
CAUSES: tuple[dict[str, Any], ...] = (
    {"pose_age_s": TIMEOUTS.pose_land_s + LATER_S},
    {"intent_age_s": TIMEOUTS.land_timeout_s + LATER_S},
    {"depth_age_s": TIMEOUTS.depth_land_s + LATER_S},
    {"refused_s": TIMEOUTS.land_timeout_s + LATER_S},
    {"inside": False},
    {"wrong": Reason(ReasonCode.ODOMETRY_DRIFT, (0.05,))},
    {"intent_age_s": TIMEOUTS.retreat_timeout_s + LATER_S},
    {"depth_age_s": TIMEOUTS.depth_retreat_s + LATER_S},
    {"pose_age_s": TIMEOUTS.pose_timeout_s + LATER_S},
    {"intent_age_s": TIMEOUTS.intent_timeout_s + LATER_S},
    {"depth_age_s": TIMEOUTS.depth_timeout_s + LATER_S},
    {"unsure": Reason(ReasonCode.PLACE_UNSURE, (0.09,))},
    {"lost": Reason(ReasonCode.POSES_DISAGREE, (0.3,))},
    {"many_refusals": True},
)


def no_command(_: Rig) -> None:
    """Leave the pilot alone."""


def fly_on(rig: Rig) -> None:
    rig.fly((2.5, 0.0, 1.1), identifier=9)


def operator_holds(rig: Rig) -> None:
    rig.pilot.operator.request_hold(True)


def operator_lands(rig: Rig) -> None:
    rig.pilot.operator.request_land(Reason(ReasonCode.OPERATOR_LAND))


def mission_lands(rig: Rig) -> None:
    rig.intent = (Goal.LAND, None)


COMMANDS: tuple[tuple[Callable[[Rig], None], Override | None], ...] = (
    (no_command, None),
    (fly_on, None),
    (operator_holds, Override.OPERATOR_HOLD),
    (operator_lands, Override.LAND),
    (mission_lands, Override.LAND),
)


@pytest.fixture(scope="module")
def flown_out(flown_up: Rig) -> Rig:
    """Return a vehicle at rest away from the pad; tests copy it."""
    rig = flight_copy(flown_up)
    rig.run(rig.fly((OUT_X_M, 0.0, 1.1), identifier=2).duration_s + 2.0)
    return rig


def cause_from_now_on(rig: Rig, changes: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Give every failsafe these inputs; a cause that needs time is given it."""
    step = Failsafe.step
    monkeypatch.setattr(Failsafe, "step", lambda self, inputs: step(self, dataclasses.replace(inputs, **changes)))
    if "inside" in changes:
        rig.run(OUTSIDE_S)


def action_of(rig: Rig, seconds: float) -> FailsafeAction:
    """Watch the vehicle and return what it does."""
    rig.run(seconds)
    if rig.pilot.phase is not FlightPhase.FLYING:
        assert rig.pilot.phase is FlightPhase.LANDING
        return FailsafeAction.LAND
    off_m = float(rig.autopilot.truth().position[0]) - OUT_X_M
    return FailsafeAction.FLY if off_m > 0.2 else FailsafeAction.RETREAT if off_m < -0.2 else FailsafeAction.HOLD


def test_each_cause_is_that_of_its_row() -> None:
    assert len(CAUSES) == len(CONDITIONS)
    for row, changes in enumerate(CAUSES):
        inputs = dataclasses.replace(FailsafeInputs(0.0, 0.0, 0.0, 0.0, True), **changes)
        outside_s = 0.0 if inputs.inside else OUTSIDE_S + LATER_S
        seen = Observation(inputs, outside_s, TIMEOUTS)
        assert next(n for n, condition in enumerate(CONDITIONS) if condition.cause(seen) is not None) == row


@pytest.mark.parametrize("row", range(len(CONDITIONS)))
def test_only_the_commands_of_a_row_replace_its_action(flown_out: Rig, row: int, monkeypatch: pytest.MonkeyPatch) -> None:
    condition, caused = CONDITIONS[row], flight_copy(flown_out)
    cause_from_now_on(caused, CAUSES[row], monkeypatch)
    for command, override in COMMANDS:
        rig = flight_copy(caused)
        command(rig)
        done = action_of(rig, WATCHED_S[condition.action]) is condition.action
        assert done == (override not in condition.overrides), command.__name__


def test_a_hold_of_the_operator_stops_a_retreat_whose_cause_stays_in_words_and_lands(flown_out: Rig) -> None:
    rig = flight_copy(flown_out)
    begin_s, rig.depth = rig.clock.now_s(), False
    rig.run(TIMEOUTS.depth_retreat_s + 1.0)
    assert rig.note_codes == (ReasonCode.NO_DEPTH,)
    assert float(rig.autopilot.truth().position[0]) < OUT_X_M - 0.05, "on its way back"
    rig.pilot.operator.request_hold(True)
    rig.run(1.0)
    held_m = float(rig.autopilot.truth().position[0])
    rig.run(TIMEOUTS.depth_land_s - (rig.clock.now_s() - begin_s) - 0.5)
    assert rig.pilot.phase is FlightPhase.FLYING
    assert abs(float(rig.autopilot.truth().position[0]) - held_m) < 0.05
    assert rig.note_codes == (ReasonCode.NO_DEPTH,)
    rig.until(FlightPhase.LANDING, 1.5)
    assert rig.note_codes == (ReasonCode.NO_DEPTH,)


@pytest.mark.parametrize("row", range(len(CONDITIONS)))
def test_a_human_with_the_sticks_overrides_every_row(flown_out: Rig, row: int, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = flight_copy(flown_out)
    cause_from_now_on(rig, CAUSES[row], monkeypatch)
    rig.run(0.5)
    rig.px4.pilot_takes_over("POSCTL")
    rig.until(FlightPhase.YIELDED, 1.5)


def test_without_a_cause_a_trajectory_of_the_mission_is_flown(flown_out: Rig) -> None:
    rig = flight_copy(flown_out)
    fly_on(rig)
    assert action_of(rig, 2.0) is FailsafeAction.FLY
