"""Keyframe capture: gives the mapper the planned views and other frames worth a view."""

from __future__ import annotations

from uav_recon.mission.log.mission_log import MissionLog
from uav_recon.mission.setup.mission_stages import MissionStages
from uav_recon.mission.trajectory.flight_track import FlightTrack
from uav_recon.mission.trajectory.view_schedule import ViewSchedule
from uav_recon.types.camera import PosedFrame


class KeyframeCapture:
    """Chooses the keyframes of one mission, within the budget of views."""

    def __init__(self, stages: MissionStages, schedule: ViewSchedule, track: FlightTrack, log: MissionLog) -> None:
        self._stages = stages
        self._schedule = schedule
        self._track = track
        self._log = log

    def capture(self, now_s: float, posed: PosedFrame, surveying: bool) -> None:
        """Give the mapper a frame that is a planned view or, while surveying, worth a view.

        Views of the look round and of the tasks are taken in any case, if the vehicle is on its track. A frame that shows
        something that moves is no view: the model would keep it. A planned view waits for the next frame.
        """
        if self._stages.voxels.shows_motion:
            return
        planned = self._schedule.take(posed.frame.stamp_s) and self._track.is_on_track(now_s)
        if self._log.views_left <= 0 or not (planned or (surveying and self._is_worth_a_view(posed))):
            return
        if self._stages.mapper.add(posed):
            self._stages.budget.keep(posed)
            self._log.view(posed)

    def _is_worth_a_view(self, posed: PosedFrame) -> bool:
        return self._stages.budget.selects(posed, self._log.views_left, explored=self._log.explored)
