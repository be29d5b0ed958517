"""Mission publisher: the message to the pilot, the maps, and the progress report."""

from __future__ import annotations

import math

import numpy as np

from uav_recon.mission.log.mission_log import MissionLog
from uav_recon.mission.publication.map_publisher import MapPublisher
from uav_recon.mission.publication.seeing_heading import SeeingHeading
from uav_recon.mission.requests.operator_watchdog import OperatorWatchdog
from uav_recon.mission.setup.mission_channels import MissionChannels
from uav_recon.mission.setup.mission_stages import MissionStages
from uav_recon.mission.state_machine import Phase
from uav_recon.mission.trajectory.flight_track import FlightTrack
from uav_recon.types.maps import VoxelMap
from uav_recon.types.trajectory import Goal, Intent

PROGRESS_PERIOD_S = 0.2  #: internal: interval of the progress report
_GROUNDED = (Phase.IDLE, Phase.READY, Phase.DONE, Phase.YIELDED)


class MissionPublisher:
    """Publishes the result of each step: the intent always, maps and progress when they are due."""

    def __init__(
        self,
        stages: MissionStages,
        channels: MissionChannels,
        track: FlightTrack,
        log: MissionLog,
        watchdog: OperatorWatchdog,
        camera_pitch_down_rad: float,
    ) -> None:
        self._stages = stages
        self._channels = channels
        self._track = track
        self._log = log
        self._watchdog = watchdog
        self._map_publisher = MapPublisher(channels)
        self._camera_pitch_down_rad = camera_pitch_down_rad
        self._heading = SeeingHeading(stages.localizability, track, camera_pitch_down_rad)
        self._reported_s = -np.inf

    def publish(self, now_s: float, phase: Phase, voxels: VoxelMap | None) -> None:
        """Publish the free space before the intent that was planned in it, then maps and progress."""
        self._map_publisher.free(now_s, voxels, self._track.trajectory)
        self._channels.intent.publish(self._intent(now_s, phase))
        self._map_publisher.maps(now_s, voxels, self._stages.mapper, last=phase.finished)
        if now_s - self._reported_s >= PROGRESS_PERIOD_S or phase.finished:
            self._reported_s = now_s
            self._report_progress(now_s, phase)

    def _intent(self, now_s: float, phase: Phase) -> Intent:
        goal = Goal.STANDBY if phase in _GROUNDED else Goal.LAND if phase is Phase.LANDING else Goal.FLY
        note = self._log.aborted or self._watchdog.note
        seeing_yaw_rad = self._heading.yaw_rad(now_s) if goal is Goal.FLY else None
        return Intent(now_s, goal, self._track.trajectory, note, bool(self._watchdog.lost), seeing_yaw_rad)

    def _report_progress(self, now_s: float, phase: Phase) -> None:
        explored_m3, track = self._stages.voxels.explored_m3(), self._track
        progress = self._log.progress(
            now_s, phase, explored_m3, track.path_length_m, track.position_world, phase.finished,
            self._predicted_sigma_m(), self._measured_sigma_m(),
        )  # fmt: skip
        self._channels.progress.publish(progress)

    def _predicted_sigma_m(self) -> float | None:
        """Return how well the view should show the place; None without a surface for it."""
        localizability = self._stages.localizability
        if localizability is None:
            return None
        return localizability.sigma_m(self._track.world_from_body, self._camera_pitch_down_rad)

    def _measured_sigma_m(self) -> float | None:
        """Return how well the pose of the newest frame is known; None if that is not known."""
        posed = self._channels.frames.latest()
        return None if posed is None or math.isnan(posed.place_sigma_m) else posed.place_sigma_m
