"""View schedule: capture instants, each met by the first frame at or after it."""

from __future__ import annotations

from uav_recon.types.trajectory import Trajectory

VIEW_LATE_S = 0.6  #: plan: a view is given up if no frame came within this time


class ViewSchedule:
    """Pending capture instants, in absolute seconds."""

    def __init__(self, late_s: float = VIEW_LATE_S) -> None:
        self._instants_s: list[float] = []
        self._late_s = late_s

    def expect(self, trajectory: Trajectory, after_s: float) -> None:
        """Replace the views after ``after_s`` by those of a trajectory.

        after_s: instant at which it leaves the one before.
        """
        self.cancel_after(after_s)
        self._instants_s += [trajectory.start_s + float(t) for t in trajectory.views_s]

    def cancel_after(self, instant_s: float) -> None:
        """Drop the views that a stopped trajectory will not reach."""
        self._instants_s = [t for t in self._instants_s if t <= instant_s]

    def take(self, stamp_s: float) -> bool:
        """Return True if the frame captured at ``stamp_s`` is a view.

        One frame serves all instants up to its stamp.
        """
        met = [t for t in self._instants_s if t <= stamp_s]
        self._instants_s = [t for t in self._instants_s if t > stamp_s]
        return bool(met)

    def waiting(self, now_s: float) -> bool:
        """Return True if a view is still pending; a view that no frame met in time is given up."""
        self._instants_s = [t for t in self._instants_s if now_s - t < self._late_s]
        return bool(self._instants_s)
