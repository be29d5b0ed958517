"""Reception of the operator's commands, from the pilot to the conductor."""

from __future__ import annotations

from typing import Protocol

from uav_recon.interfaces import Channel
from uav_recon.types.operator_command import GivenCommand, OperatorCommand
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode


class CommandTarget(Protocol):
    """The conductor's interface for commands. Nothing blocks."""

    def request_start(self) -> None:
        """Take off and begin."""
        ...

    def request_hold(self) -> None:
        """Hold position."""
        ...

    def request_return(self) -> None:
        """Fly home and land."""
        ...

    def request_abort(self, reason: Reason) -> None:
        """Land here."""
        ...

    def resume(self) -> None:
        """Continue after a hold."""
        ...


class OperatorCommandReceiver:
    """Passes each command on once. Commands from before this mission began are ignored."""

    def __init__(self, channel: Channel[GivenCommand], begun_s: float) -> None:
        self._channel = channel
        self._received_s = begun_s
        self._start = False

    def pass_on(self, conductor: CommandTarget, warm: bool, autostart: bool) -> None:
        """Process the newest command.

        A start waits until every stage is warm. With autostart it needs no command.
        """
        given = self._newest()
        if given is not None and given.stamp_s > self._received_s:
            self._received_s = given.stamp_s
            self._obey(given.order, conductor)
        if (self._start or autostart) and warm:
            conductor.request_start()

    def _newest(self) -> GivenCommand | None:
        try:
            return self._channel.latest()
        except ValueError:
            return None

    def _obey(self, order: OperatorCommand, conductor: CommandTarget) -> None:
        if order is OperatorCommand.START:
            self._start = True
            conductor.resume()
        elif order is OperatorCommand.HOLD:
            conductor.request_hold()
        elif order is OperatorCommand.RETURN:
            conductor.request_return()
        else:
            conductor.request_abort(Reason(ReasonCode.OPERATOR_LAND))
