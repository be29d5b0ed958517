"""Orders on their way from the pilot's desk to the conductor."""

from __future__ import annotations

import pytest

from uav_recon.channels import MemoryChannel
from uav_recon.mission.operator_commands import OperatorCommandReceiver
from uav_recon.types.operator_command import GivenCommand, OperatorCommand
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode


class Conductor:
    """Notes what it is asked."""

    def __init__(self) -> None:
        self.asked: list[str | Reason] = []

    def request_start(self) -> None:
        self.asked.append("start")

    def request_hold(self) -> None:
        self.asked.append("hold")

    def request_return(self) -> None:
        self.asked.append("return")

    def request_abort(self, reason: Reason) -> None:
        self.asked.append(reason)

    def resume(self) -> None:
        self.asked.append("resume")


@pytest.mark.parametrize(
    ("order", "asked"),
    [
        (OperatorCommand.START, ["resume", "start"]),
        (OperatorCommand.HOLD, ["hold"]),
        (OperatorCommand.RETURN, ["return"]),
        (OperatorCommand.LAND, [Reason(ReasonCode.OPERATOR_LAND)]),
    ],
)
def test_each_order_is_passed_on_once(order: OperatorCommand, asked: list[str | Reason]) -> None:
    channel, conductor = MemoryChannel(GivenCommand), Conductor()
    standing = OperatorCommandReceiver(channel, 10.0)
    channel.publish(GivenCommand(11.0, order))
    for _ in range(3):
        standing.pass_on(conductor, warm=True, autostart=False)
    assert [word for word in conductor.asked if word != "start"] == [word for word in asked if word != "start"]
    assert ("start" in conductor.asked) is (order is OperatorCommand.START)


def test_what_was_said_to_an_earlier_mission_starts_nothing() -> None:
    channel, conductor = MemoryChannel(GivenCommand), Conductor()
    channel.publish(GivenCommand(9.9, OperatorCommand.START))
    OperatorCommandReceiver(channel, 10.0).pass_on(conductor, warm=True, autostart=False)
    assert conductor.asked == []


def test_a_start_waits_until_everything_is_warm() -> None:
    channel, conductor = MemoryChannel(GivenCommand), Conductor()
    standing = OperatorCommandReceiver(channel, 10.0)
    channel.publish(GivenCommand(11.0, OperatorCommand.START))
    standing.pass_on(conductor, warm=False, autostart=False)
    assert conductor.asked == ["resume"]
    standing.pass_on(conductor, warm=True, autostart=False)
    assert conductor.asked == ["resume", "start"]


def test_where_it_starts_by_itself_nobody_is_asked() -> None:
    conductor = Conductor()
    standing = OperatorCommandReceiver(MemoryChannel(GivenCommand), 10.0)
    standing.pass_on(conductor, warm=False, autostart=True)
    assert conductor.asked == []
    standing.pass_on(conductor, warm=True, autostart=True)
    assert conductor.asked == ["start"]
