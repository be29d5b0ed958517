"""Reception of the operator's commands, from the pilot to the mission."""

from __future__ import annotations

from uav_recon.interfaces import Channel
from uav_recon.mission.requests.mission_requests import MissionRequests
from uav_recon.types.operator_command import GivenCommand, OperatorCommand
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode


class OperatorCommandReceiver:
    """Passes each command on once. Commands from before this mission began are ignored."""

    def __init__(self, channel: Channel[GivenCommand], begun_s: float) -> None:
        self._channel = channel
        self._received_s = begun_s
        self._start = False

    def pass_on(self, requests: MissionRequests, warm: bool, autostart: bool) -> None:
        """Process the newest command.

        A start waits until every stage is warm. With autostart it needs no command.
        """
        given = self._newest()
        if given is not None and given.stamp_s > self._received_s:
            self._received_s = given.stamp_s
            self._apply(given.order, requests)
        if (self._start or autostart) and warm:
            requests.start()

    def _newest(self) -> GivenCommand | None:
        try:
            return self._channel.latest()
        except ValueError:
            return None

    def _apply(self, order: OperatorCommand, requests: MissionRequests) -> None:
        if order is OperatorCommand.START:
            self._start = True
            requests.resume()
        elif order is OperatorCommand.HOLD:
            requests.hold()
        elif order is OperatorCommand.RETURN:
            requests.return_home()
        else:
            requests.abort(Reason(ReasonCode.OPERATOR_LAND))
