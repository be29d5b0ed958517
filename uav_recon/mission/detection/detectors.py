"""Detectors: each watches one source and yields the events that need a response now."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from uav_recon.mission.battery.battery_policy import BatteryPolicy
from uav_recon.mission.requests.operator_watchdog import OperatorWatchdog
from uav_recon.mission.trajectory.async_planning import AsyncPlanner
from uav_recon.mission.trajectory.flight_track import FlightTrack
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import FlightPhase, VehicleState

PLAN_LATE_S = 20.0  #: land: a planner that has not answered for longer is treated as dead: the way home comes from it too


class Response(Enum):
    """Response of the conductor to an event."""

    NOTE = "log it, and show it to the operator"
    NOTE_IN_HOLD = "show it to an operator who holds the vehicle"
    REPLAN = "hover where the guard stopped the vehicle, and plan again"
    RETURN = "fly home and land"
    REFUSE_TAKEOFF = "end the mission if it is about to take off"
    LAND = "land now"


@dataclass(frozen=True, slots=True)
class MissionEvent:
    """A response and its reason."""

    response: Response
    reason: Reason


class Detector(Protocol):
    """Detector of one kind of trouble; called once in each step. Never blocks."""

    def detect(self, now_s: float, vehicle: VehicleState) -> Iterator[MissionEvent]:
        """Yield the events of this step, in the order of the responses."""
        ...


class RefusedTrajectoryDetector:
    """Detects that the guard refused the present trajectory."""

    def __init__(self, track: FlightTrack) -> None:
        self._track = track
        self._refusals = 0

    def detect(self, now_s: float, vehicle: VehicleState) -> Iterator[MissionEvent]:
        """Yield an event for new refusals, with the pilot's reason."""
        if vehicle.refusals > self._refusals and self._track.trajectory is not None:
            yield MissionEvent(Response.REPLAN, vehicle.note or Reason(ReasonCode.REFUSED))
        self._refusals = vehicle.refusals


class MissingOperatorDetector:
    """Detects that the operator is silent, lost or back.

    A lost operator cannot hold the vehicle either, so the event comes in every step.
    """

    def __init__(self, watchdog: OperatorWatchdog) -> None:
        self._watchdog = watchdog

    def detect(self, now_s: float, vehicle: VehicleState) -> Iterator[MissionEvent]:
        """Update the watchdog; yield its news, and the return while the operator is lost."""
        if news := self._watchdog.update(now_s, vehicle.operator_received_s, flying=vehicle.armed):
            yield MissionEvent(Response.NOTE, news)
        if self._watchdog.lost:
            yield MissionEvent(Response.RETURN, self._watchdog.lost)


class DeadPlannerDetector:
    """Detects a dead planner: every trajectory comes from it, the way home too."""

    def __init__(self, planner: AsyncPlanner) -> None:
        self._planner = planner

    def detect(self, now_s: float, vehicle: VehicleState) -> Iterator[MissionEvent]:
        """Yield an event while a request has been running for longer than PLAN_LATE_S."""
        if self._planner.waiting_s(now_s) > PLAN_LATE_S:
            yield MissionEvent(Response.LAND, Reason(ReasonCode.PLANNER_SILENT, (PLAN_LATE_S,)))


class LowBatteryDetector:
    """Detects too little charge to take off, to stay in the air, or to be held away from home."""

    def __init__(self, policy: BatteryPolicy) -> None:
        self._policy = policy

    def detect(self, now_s: float, vehicle: VehicleState) -> Iterator[MissionEvent]:
        """Yield the events of the charge. Call BatteryPolicy.update before."""
        policy, flying = self._policy, vehicle.phase is FlightPhase.FLYING
        if refused := policy.takeoff_refusal():
            yield MissionEvent(Response.REFUSE_TAKEOFF, refused)
        if flying and (reason := policy.landing_reason()):
            yield MissionEvent(Response.LAND, reason)
        elif flying and policy.must_return:
            yield MissionEvent(Response.NOTE_IN_HOLD, policy.return_reason())
