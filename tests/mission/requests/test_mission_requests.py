"""Requests to the mission last, except for a hold; the first reason stays."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from uav_recon.mission.log.mission_log import MissionLog
from uav_recon.mission.requests.mission_requests import MissionRequests
from uav_recon.mission.requests.operator_watchdog import WARN_S, OperatorWatchdog
from uav_recon.recording.flight_log import FlightLog
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

LOW, LATE = Reason(ReasonCode.BATTERY_UNKNOWN), Reason(ReasonCode.PLANNER_SILENT, (20.0,))


@pytest.fixture()
def log(tmp_path: Path) -> Iterator[MissionLog]:
    journal = FlightLog(tmp_path)
    yield MissionLog(journal, 10)
    journal.close()


def test_a_hold_is_released_once(log: MissionLog) -> None:
    requests = MissionRequests(OperatorWatchdog(), log)
    requests.resume()
    assert not requests.take_release(), "there was no hold"
    requests.hold()
    states = [(requests.held, requests.take_release())]
    requests.resume()
    requests.resume()
    states.append((requests.held, requests.take_release()))
    states.append((requests.held, requests.take_release()))
    assert states == [(True, False), (False, True), (False, False)]


def test_a_return_ends_a_hold_and_keeps_its_first_reason(log: MissionLog) -> None:
    requests = MissionRequests(OperatorWatchdog(), log)
    requests.hold()
    requests.return_home(LOW)
    requests.return_home()
    assert requests.take_release() and not requests.held
    assert requests.return_reason == LOW
    other = MissionRequests(OperatorWatchdog(), log)
    other.return_home()
    assert other.return_reason == Reason(ReasonCode.OPERATOR_RETURN)


def test_an_abort_keeps_its_first_reason(log: MissionLog) -> None:
    requests = MissionRequests(OperatorWatchdog(), log)
    requests.abort(LATE)
    requests.abort(LOW)
    assert requests.aborted and log.aborted == LATE


def test_a_start_waits_for_an_operator_who_is_missing(log: MissionLog) -> None:
    watchdog = OperatorWatchdog(30.0)
    requests = MissionRequests(watchdog, log)
    watchdog.update(100.0, 100.0, flying=False)
    states = [(requests.startable, requests.start_blocker)]
    requests.start()
    states.append((requests.startable, requests.start_blocker))
    watchdog.update(100.1 + WARN_S, 100.0, flying=False)
    states.append((requests.startable, requests.start_blocker))
    assert states == [(False, None), (True, None), (False, Reason(ReasonCode.OPERATOR_MISSING))]
