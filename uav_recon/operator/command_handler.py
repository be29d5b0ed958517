"""Command handler: carries out commands, passes them to the mission, or refuses them."""

from __future__ import annotations

import math
from typing import Protocol, TypeVar

from uav_recon.interfaces import Channel, Clock
from uav_recon.operator.command_socket import Answer
from uav_recon.operator.status import Status
from uav_recon.operator.status_channels import StatusChannels
from uav_recon.types.operator_command import GivenCommand, OperatorCommand
from uav_recon.types.reason import Reason, codes_of
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import FlightPhase

T = TypeVar("T")

SILENT_S = 2.0  #: refuse: a command to a mission whose newest intent is older
_FUTURE_S = 0.1  #: refuse: the same if its stamp is later than the clock by this
_ON_THE_GROUND = (FlightPhase.CONNECTING, FlightPhase.READY, FlightPhase.LANDED)


class OperatorControls(Protocol):
    """Requests that an operator may make to the pilot. Nothing blocks."""

    def request_land(self, why: Reason) -> None:
        """Land here and now, regardless of the mission."""
        ...

    def request_hold(self, hold: bool) -> None:
        """Hold position regardless of the mission, or follow the mission again."""
        ...

    def hear_operator(self) -> None:
        """Record that the operator is present now."""
        ...


class PilotControls(Protocol):
    """The pilot's interface for an operator."""

    @property
    def phase(self) -> FlightPhase:
        """Phase of the flight."""
        ...

    @property
    def operator(self) -> OperatorControls:
        """The operator's requests."""
        ...


class CommandHandler:
    """Serves the command socket.

    channels: are only read. commands: channel to the mission.
    """

    def __init__(
        self,
        pilot: PilotControls,
        channels: StatusChannels,
        commands: Channel[GivenCommand],
        clock: Clock,
    ) -> None:
        self._pilot = pilot
        self._channels = channels
        self._commands = commands
        self._clock = clock

    def serve(self, word: str) -> Answer:
        """Return the answer to a word, which is status or a command.

        A command is carried out before it is answered. Every known word counts as an operator heartbeat, also if it is refused.
        """
        try:
            command = None if word == "status" else OperatorCommand(word)
        except ValueError:
            words = ", ".join((*(command.value for command in OperatorCommand), "status"))
            unknown = Reason(ReasonCode.UNKNOWN_COMMAND, (repr(word[:20]), words))
            return {"ok": False, "said": unknown.text(), "codes": list(unknown.codes())}
        self._pilot.operator.hear_operator()
        if command is None:
            return {"ok": True, "said": "", "status": self.status().as_json()}
        refused = self._refusal(command)
        said = self._carry_out(command) if refused is None else refused.text()
        return {"ok": refused is None, "said": said, "codes": list(codes_of(refused))}

    def status(self) -> Status:
        """Return the present status."""
        return Status.of(
            self._clock.now_s(),
            _newest(self._channels.vehicle),
            _newest(self._channels.odom),
            _newest(self._channels.progress),
            self._mission_receives(),
            _newest(self._channels.perception),
        )

    def _refusal(self, command: OperatorCommand) -> Reason | None:
        phase = self._pilot.phase
        if phase is FlightPhase.YIELDED:
            return Reason(ReasonCode.CONTROL_HANDED_OVER, details=self._note())
        if command is OperatorCommand.START:
            return self._refusal_of_start(phase)
        if phase in _ON_THE_GROUND:
            return Reason(ReasonCode.NOT_FLYING, (phase.value, command.value))
        return None if command is OperatorCommand.LAND else self._refusal_in_flight(command, phase)

    def _refusal_of_start(self, phase: FlightPhase) -> Reason | None:
        if phase in (FlightPhase.LANDING, FlightPhase.LANDED):
            return Reason(ReasonCode.FLIGHT_OVER)
        if phase is FlightPhase.CONNECTING:
            return Reason(ReasonCode.NOT_READY, details=self._note(Reason(ReasonCode.STARTING)))
        return None if self._mission_receives() else Reason(ReasonCode.MISSION_NOT_RUNNING)

    def _refusal_in_flight(self, command: OperatorCommand, phase: FlightPhase) -> Reason | None:
        if phase is FlightPhase.ARMING:
            return Reason(ReasonCode.TAKING_OFF)
        if phase is FlightPhase.LANDING:
            return Reason(ReasonCode.LANDING_IS_FINAL)
        if command is OperatorCommand.RETURN and not self._mission_receives():
            return Reason(ReasonCode.MISSION_CANNOT_RETURN)
        return None

    def _carry_out(self, command: OperatorCommand) -> str:
        if command is OperatorCommand.LAND:
            self._pilot.operator.request_land(Reason(ReasonCode.OPERATOR_LAND))
        else:
            self._pilot.operator.request_hold(command is OperatorCommand.HOLD)
        self._commands.publish(GivenCommand(self._clock.now_s(), command))
        grounded = self._pilot.phase in _ON_THE_GROUND
        going = "it takes off when the mission is ready" if grounded else "the mission continues"
        return {
            OperatorCommand.LAND: "landing",
            OperatorCommand.HOLD: "holding",
            OperatorCommand.RETURN: "returning",
            OperatorCommand.START: going,
        }[command]

    def _note(self, *default: Reason) -> tuple[Reason, ...]:
        """Return the pilot's newest reason as details.

        default: the answer before there is any state of the vehicle.
        """
        vehicle = _newest(self._channels.vehicle)
        if vehicle is None:
            return default
        return () if vehicle.note is None else (vehicle.note,)

    def _mission_receives(self) -> bool:
        intent = _newest(self._channels.intent)
        age_s = math.inf if intent is None else self._clock.now_s() - intent.stamp_s
        return -_FUTURE_S <= age_s <= SILENT_S


def _newest(channel: Channel[T]) -> T | None:
    try:
        return channel.latest()
    except ValueError:
        return None
