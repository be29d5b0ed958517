"""What the mission wants of the pilot, as long as it may be listened to."""

from __future__ import annotations

import math

from uav_recon.autopilot.pilot.message_validation import trajectory_fault
from uav_recon.interfaces import Channel
from uav_recon.types.reason import Reason
from uav_recon.types.trajectory import Goal, Intent, Trajectory

_FUTURE_S = 0.1

Key = tuple[int, float]


class MissionInput:
    """The newest intent and its trajectory. A trajectory that was forsaken is not taken up again; ``malformed`` counts."""

    def __init__(self, intent: Channel[Intent], fresh_s: float) -> None:
        self._channel, self._fresh_s = intent, fresh_s
        self._intent: Intent | None = None
        self._wanted_s = -math.inf  # stamp of its last wish
        self._rejected: Key | None = None  # malformed, turned down, or made in an odom that is no more
        self.trajectory: Trajectory | None = None
        self.news: Reason | None = None  # what it has to tell people, once: None in every other turn
        self._told: Reason | None = None
        self.malformed = 0

    def update(self, now_s: float) -> Reason | None:
        """Take over the newest intent; why its trajectory cannot be flown, once, None if it can."""
        self.news = None
        try:
            intent = self._channel.latest()
        except ValueError:
            intent = None
        if intent is None or intent is self._intent or not -_FUTURE_S <= now_s - intent.stamp_s <= self._fresh_s:
            return None
        self._intent = intent
        self.news, self._told = None if intent.note == self._told else intent.note, intent.note
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
            self.malformed += 1
        return fault

    def reject_trajectory(self) -> None:
        """Fly this trajectory no more: the mission has to propose another one."""
        self._rejected, self.trajectory = _key(self.trajectory) or self._rejected, None  # twice is not never

    def age_s(self, now_s: float) -> float:
        """Seconds since the mission last wanted anything, infinity before the first.

        One that stands by is silent: in flight it has been started anew, and knows nothing of the flight that it is in.
        """
        return now_s - self._wanted_s

    def operator_lost(self, now_s: float) -> bool:
        """Whether a mission that is not silent says that nobody attends any more."""
        return self._intent is not None and self.age_s(now_s) <= self._fresh_s and self._intent.operator_lost

    def goal(self, now_s: float) -> Goal:
        """What a mission that is not silent wants, STANDBY otherwise."""
        if self._intent is None or self.age_s(now_s) > self._fresh_s:
            return Goal.STANDBY
        return self._intent.goal


def _key(trajectory: Trajectory | None) -> Key | None:
    """A restarted mission counts from zero again, so the start belongs to a trajectory's name."""
    return None if trajectory is None else (trajectory.identifier, trajectory.start_s)
