"""Commands of the operator on their way from the pilot to the mission."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from uav_recon.channels import MemoryChannel
from uav_recon.mission.log.mission_log import MissionLog
from uav_recon.mission.requests.mission_requests import MissionRequests
from uav_recon.mission.requests.operator_commands import OperatorCommandReceiver
from uav_recon.mission.requests.operator_watchdog import OperatorWatchdog
from uav_recon.recording.flight_log import FlightLog
from uav_recon.types.operator_command import GivenCommand, OperatorCommand
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode


class NotedRequests(MissionRequests):
    """Requests that note each call."""

    def __init__(self, log: MissionLog) -> None:
        super().__init__(OperatorWatchdog(), log)
        self.asked: list[str | Reason] = []

    def start(self) -> None:
        self.asked.append("start")

    def hold(self) -> None:
        self.asked.append("hold")

    def return_home(self, why: Reason | None = None) -> None:
        self.asked.append("return")

    def abort(self, reason: Reason) -> None:
        self.asked.append(reason)

    def resume(self) -> None:
        self.asked.append("resume")


@pytest.fixture()
def requests(tmp_path: Path) -> Iterator[NotedRequests]:
    journal = FlightLog(tmp_path)
    yield NotedRequests(MissionLog(journal, 1))
    journal.close()


@pytest.mark.parametrize(
    ("order", "asked"),
    [
        (OperatorCommand.START, ["resume", "start"]),
        (OperatorCommand.HOLD, ["hold"]),
        (OperatorCommand.RETURN, ["return"]),
        (OperatorCommand.LAND, [Reason(ReasonCode.OPERATOR_LAND)]),
    ],
)
def test_each_order_is_passed_on_once(order: OperatorCommand, asked: list[str | Reason], requests: NotedRequests) -> None:
    channel = MemoryChannel(GivenCommand)
    standing = OperatorCommandReceiver(channel, 10.0)
    channel.publish(GivenCommand(11.0, order))
    for _ in range(3):
        standing.pass_on(requests, warm=True, autostart=False)
    assert [word for word in requests.asked if word != "start"] == [word for word in asked if word != "start"]
    assert ("start" in requests.asked) is (order is OperatorCommand.START)


def test_what_was_said_to_an_earlier_mission_starts_nothing(requests: NotedRequests) -> None:
    channel = MemoryChannel(GivenCommand)
    channel.publish(GivenCommand(9.9, OperatorCommand.START))
    OperatorCommandReceiver(channel, 10.0).pass_on(requests, warm=True, autostart=False)
    assert requests.asked == []


def test_a_start_waits_until_everything_is_warm(requests: NotedRequests) -> None:
    channel = MemoryChannel(GivenCommand)
    standing = OperatorCommandReceiver(channel, 10.0)
    channel.publish(GivenCommand(11.0, OperatorCommand.START))
    standing.pass_on(requests, warm=False, autostart=False)
    assert requests.asked == ["resume"]
    standing.pass_on(requests, warm=True, autostart=False)
    assert requests.asked == ["resume", "start"]


def test_where_it_starts_by_itself_nobody_is_asked(requests: NotedRequests) -> None:
    standing = OperatorCommandReceiver(MemoryChannel(GivenCommand), 10.0)
    standing.pass_on(requests, warm=False, autostart=True)
    assert requests.asked == []
    standing.pass_on(requests, warm=True, autostart=True)
    assert requests.asked == ["start"]
