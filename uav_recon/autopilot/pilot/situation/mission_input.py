"""Input from the mission, while the mission is not silent."""

from __future__ import annotations

import math

from uav_recon.autopilot.pilot.situation.message_validation import trajectory_fault
from uav_recon.interfaces import Channel
from uav_recon.safety.refusals import RefusalCounter
from uav_recon.types.reason import Reason
from uav_recon.types.trajectory import Goal, Intent, Trajectory

_FUTURE_S = 0.1  #: reject: an intent stamped later than the clock by this: its stamp is of another boot

Key = tuple[int, float]


class MissionInput:
    """The newest intent and its trajectory.

    A rejected trajectory is not accepted again. refusals: counts malformed ones.
    """

    def __init__(self, intent: Channel[Intent], fresh_s: float, refusals: RefusalCounter) -> None:
        self._channel = intent
        self._fresh_s = fresh_s
        self._intent: Intent | None = None
        self._wanted_s = -math.inf  # stamp of its last request
        self._rejected: Key | None = None  # malformed, rejected, or planned in an earlier odom
        self.trajectory: Trajectory | None = None
        self.news: Reason | None = None  # what it has to tell people, once: None in every other turn
        self._told: Reason | None = None
        self._refusals = refusals

    def update(self, now_s: float) -> Reason | None:
        """Read the newest intent; return why its trajectory cannot be flown, once, None if it can."""
        self.news = None
        try:
            intent = self._channel.latest()
        except ValueError:
            intent = None
        if intent is None or intent is self._intent or not -_FUTURE_S <= now_s - intent.stamp_s <= self._fresh_s:
            return None
        self._intent = intent
        self.news = None if intent.note == self._told else intent.note
        self._told = intent.note
        self._wanted_s = self._wanted_s if intent.goal is Goal.STANDBY else intent.stamp_s
        trajectory = intent.trajectory if intent.goal is Goal.FLY else None
        if trajectory is None:
            self.trajectory = None
            return None
        if _key(trajectory) in (_key(self.trajectory), self._rejected):
            return None
        fault = trajectory_fault(trajectory)
        self.trajectory = trajectory
        if fault:
            self.reject_trajectory()
            self._refusals.add()
        return fault

    def reject_trajectory(self) -> None:
        """Stop flying this trajectory: the mission has to propose another one."""
        # a second call keeps the rejection
        self._rejected = _key(self.trajectory) or self._rejected
        self.trajectory = None

    def age_s(self, now_s: float) -> float:
        """Return the seconds since the mission's last request, infinity before the first.

        A mission in STANDBY counts as silent: in flight it was restarted, and does not know the flight that it is in.
        """
        return now_s - self._wanted_s

    def operator_lost(self, now_s: float) -> bool:
        """Return True if a mission that is not silent reports that the operator is lost."""
        return self._intent is not None and self.age_s(now_s) <= self._fresh_s and self._intent.operator_lost

    def seeing_yaw_rad(self, now_s: float) -> float | None:
        """Return the nearest heading in which the camera shows the place.

        By a mission that is not silent; None if unknown.
        """
        yaw_rad = None if self._intent is None or self.age_s(now_s) > self._fresh_s else self._intent.seeing_yaw_rad
        return yaw_rad if yaw_rad is not None and math.isfinite(yaw_rad) else None

    def goal(self, now_s: float) -> Goal:
        """Return the goal of a mission that is not silent, STANDBY otherwise."""
        if self._intent is None or self.age_s(now_s) > self._fresh_s:
            return Goal.STANDBY
        return self._intent.goal


def _key(trajectory: Trajectory | None) -> Key | None:
    """Return the identity of a trajectory.

    A restarted mission counts from zero again, so the start is part of it.
    """
    return None if trajectory is None else (trajectory.identifier, trajectory.start_s)
