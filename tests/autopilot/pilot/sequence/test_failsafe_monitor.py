"""What is known of the failsafe between steps: the action, why, and whether it became more severe."""

from __future__ import annotations

import dataclasses

from guard_rooms import TIMEOUTS

from uav_recon.autopilot.pilot.sequence.failsafe_monitor import FailsafeMonitor
from uav_recon.safety.failsafe_precedence import FailsafeAction, FailsafeInputs
from uav_recon.safety.refusals import RefusalCounter
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

GOOD = FailsafeInputs(now_s=10.0, pose_age_s=0.0, intent_age_s=0.0, depth_age_s=0.0, inside=True)
SILENT = dataclasses.replace(GOOD, intent_age_s=1.0)
LONG_SILENT = dataclasses.replace(GOOD, now_s=10.1, intent_age_s=21.0)
UNCERTAIN = Reason(ReasonCode.CLOCK_UNCERTAIN)


def test_it_flies_without_a_reason_until_an_input_fails() -> None:
    failsafe = FailsafeMonitor(TIMEOUTS, RefusalCounter())
    assert not failsafe.update(GOOD, None)
    assert (failsafe.action, failsafe.reason) == (FailsafeAction.FLY, None)
    assert failsafe.update(SILENT, None)
    assert (failsafe.action, failsafe.reason) == (FailsafeAction.HOLD, Reason(ReasonCode.MISSION_SILENT, (1.0,)))


def test_only_a_more_severe_action_is_news() -> None:
    failsafe = FailsafeMonitor(TIMEOUTS, RefusalCounter())
    assert [failsafe.update(inputs, None) for inputs in (SILENT, SILENT, LONG_SILENT, LONG_SILENT)] == [
        True,
        False,
        True,
        False,
    ]


def test_only_a_landing_has_a_landing_reason() -> None:
    failsafe = FailsafeMonitor(TIMEOUTS, RefusalCounter())
    failsafe.update(SILENT, None)
    assert failsafe.landing_reason is None
    failsafe.update(LONG_SILENT, None)
    assert failsafe.landing_reason == failsafe.reason == Reason(ReasonCode.MISSION_SILENT, (21.0,))


def test_an_uncertain_clock_is_a_detail_of_a_reason_and_no_reason_of_its_own() -> None:
    failsafe = FailsafeMonitor(TIMEOUTS, RefusalCounter())
    failsafe.update(GOOD, UNCERTAIN)
    assert failsafe.reason is None
    failsafe.update(SILENT, UNCERTAIN)
    assert failsafe.reason == Reason(ReasonCode.MISSION_SILENT, (1.0,), details=(UNCERTAIN,))


def test_before_the_flight_inputs_prevent_the_takeoff_and_leave_no_action() -> None:
    failsafe = FailsafeMonitor(TIMEOUTS, RefusalCounter())
    assert not failsafe.prevents_takeoff(SILENT)
    assert failsafe.prevents_takeoff(LONG_SILENT)
    assert (failsafe.action, failsafe.reason) == (FailsafeAction.FLY, None)


def test_refusals_before_the_flight_do_not_count() -> None:
    counter = RefusalCounter()
    counter.add()
    refusals = FailsafeMonitor(TIMEOUTS, counter).refusals
    refusals.update(False, 10.0)
    assert refusals.refused_s == 0.0
    for now_s in (13.0, 14.5):
        counter.add()
        refusals.update(False, now_s)
    assert refusals.refused_s == 1.5
