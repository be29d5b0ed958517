"""Recorder of flight.rrd and the surface timelapse: logs new values of last-value channels.

It runs in a separate process in real time; in lockstep its step() is called inline. It never affects flight code. Values
that arrive faster than they are read are skipped and counted. Only the end of the trail is kept in memory.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from uav_recon.clock import RateKeeper
from uav_recon.interfaces import Channel, Clock
from uav_recon.recording import blueprint as names
from uav_recon.recording import rerun_archetypes
from uav_recon.recording.live_view import LiveView
from uav_recon.recording.mesh_file import load_mesh
from uav_recon.recording.recorder_channels import RecorderChannels
from uav_recon.recording.timelapse import Timelapse
from uav_recon.recording.viewer import Viewer, open_viewer
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import TriangleMesh, VoxelMap
from uav_recon.types.reason import text_of

T = TypeVar("T")

_LOG = logging.getLogger(__name__)
_FRAME_RATE_HZ = 2.0
_MAP_RATE_HZ = 0.5
_FLUSH_RATE_HZ = 0.5  # each flush ends a chunk of every entity ...
_BATCH_S = 60.0  # ... and nothing else does
_RUST_LOG_FILTER = "warn,re_log_encoding=error"  # a missing file footer is expected, so it is not reported
_FLUSH_TIMEOUT_S = 1.0
_TRAIL_STEP_M = 0.05
_TRAIL_STRIP_POINTS = 100


class Inbox(Generic[T]):
    """Returns each value of a channel once.

    skipped: number of values that were replaced before being read.
    """

    def __init__(self, channel: Channel[T]) -> None:
        self._channel = channel
        self._read = 0
        self.skipped = 0

    def new(self) -> T | None:
        """Return the newest value if it was not returned yet, else None."""
        sequence = self._channel.sequence()
        if sequence == self._read:
            return None
        value = self._channel.latest()
        if value is None:
            return None
        self.skipped += max(0, sequence - self._read - 1)
        self._read = sequence
        return value


class RerunRecorder:
    """Records one flight to ``folder``/flight.rrd, and to a viewer if ``live`` and available.

    fence_world_m (2, 3): lower and upper corner. The timeline counts seconds from construction. The constructor raises
    OSError if the file cannot be written.
    """

    def __init__(
        self,
        folder: Path,
        channels: RecorderChannels,
        clock: Clock,
        fence_world_m: FloatArray,
        live: bool = False,
        find_viewer: Callable[[], Viewer | None] = open_viewer,
    ) -> None:
        os.environ.setdefault("RUST_LOG", _RUST_LOG_FILTER)
        import rerun as rr

        self._folder = folder
        self._clock = clock
        self._start_s = clock.now_s()
        self._odom = Inbox(channels.odom)
        self._frames = Inbox(channels.frames)
        self._vehicle = Inbox(channels.vehicle)
        self._intent = Inbox(channels.intent)
        self._progress = Inbox(channels.progress)
        self._plan = Inbox(channels.plan)
        self._voxels = Inbox(channels.voxels)
        self._surface = Inbox(channels.surface)
        self._frames_due = RateKeeper(_FRAME_RATE_HZ, self._start_s)
        self._maps_due = RateKeeper(_MAP_RATE_HZ, self._start_s)
        self._flush_due = RateKeeper(_FLUSH_RATE_HZ, self._start_s)
        self._trail: list[FloatArray] = []
        self._trail_strip = 0
        self._map: VoxelMap | None = None
        self._trajectory_id = -1
        self._said: dict[str, str] = {}

        path = folder / names.RECORDING
        path.open("wb").close()  # reports a folder that cannot be written here, with its name
        self._timelapse = Timelapse(folder, channels.surface, clock)
        batches = rr.ChunkBatcherConfig.DEFAULT()
        batches.flush_tick = timedelta(seconds=_BATCH_S)
        self._file = rr.RecordingStream(names.APPLICATION, batcher_config=batches)
        self._file.save(path, write_footer=False)  # a footer would keep a line for each chunk in memory until the end
        viewer = find_viewer() if live else None
        self._live = None if viewer is None else LiveView(viewer)
        for stream in self._streams():
            stream.send_blueprint(names.review_blueprint())
        self._draw(rerun_archetypes.scene(np.asarray(fence_world_m, dtype=np.float64)), static=True)

    def step(self) -> None:
        """Log all new values; call it about ten times per second."""
        self._timelapse.step()
        now_s = self._clock.now_s()
        self._set_time(now_s)
        self._log_odom()
        self._log_vehicle()
        self._log_mission()
        if self._frames_due.due(now_s) and (frame := self._frames.new()) is not None:
            self._draw(rerun_archetypes.frame(frame))
        if self._maps_due.due(now_s):
            self._log_maps()
        if self._flush_due.due(now_s):
            self._flush()

    def skipped(self) -> dict[str, int]:
        """Return the number of values of each channel that were replaced before being read."""
        return {
            name: inbox.skipped
            for name, inbox in (
                ("odom", self._odom), ("frames", self._frames), ("vehicle", self._vehicle), ("intent", self._intent),
                ("progress", self._progress), ("voxels", self._voxels), ("surface", self._surface), ("plan", self._plan),
            )
        }  # fmt: skip

    def close(self, mesh: TriangleMesh | None = None) -> None:
        """Log the last values and the finished model, and end the file.

        A viewer delays this by about two seconds at most. mesh: the model; by default ``folder``/mesh.ply.
        """
        self._timelapse.close()
        self._set_time(self._clock.now_s())
        self._log_odom()
        self._log_vehicle()
        self._log_mission()
        self._log_maps()
        mesh = mesh or load_mesh(self._folder)
        if mesh is not None:
            self._draw(rerun_archetypes.mesh(mesh, self._trail[-1] if self._trail else None))
        self._file.disconnect()
        if self._live is not None:
            self._live.close()

    def _log_odom(self) -> None:
        odom = self._odom.new()
        if odom is None:
            return
        self._draw(rerun_archetypes.body(odom.odom_from_body))
        self._plot(names.SPEED, float(np.linalg.norm(odom.velocity_odom_mps)))
        position = odom.odom_from_body.translation_m
        if self._map is not None and (distance_m := _distance_m(self._map, position)) is not None:
            self._plot(names.CLEARANCE, distance_m)
        if not self._trail or float(np.linalg.norm(position - self._trail[-1])) >= _TRAIL_STEP_M:
            self._trail.append(position)
            self._draw(rerun_archetypes.trail(self._trail_strip, np.array(self._trail)))
        if len(self._trail) >= _TRAIL_STRIP_POINTS:
            self._trail = self._trail[-1:]
            self._trail_strip = self._trail_strip + 1

    def _log_vehicle(self) -> None:
        vehicle = self._vehicle.new()
        if vehicle is None:
            return
        armed = "armed" if vehicle.armed else "disarmed"
        self._say("pilot", f"{vehicle.phase.value}, {vehicle.mode}, {armed}")
        self._say("pilot note", text_of(vehicle.note))

    def _log_mission(self) -> None:
        progress = self._progress.new()
        if progress is not None:
            self._plot(names.EXPLORED, progress.explored_m3)
            self._plot(names.VIEWS, float(progress.views))
            self._plot(names.FRONTIERS, float(progress.frontiers))
            for entity, sigma_m in (
                (names.PLACE_PREDICTED, progress.predicted_sigma_m),
                (names.PLACE_MEASURED, progress.measured_sigma_m),
            ):
                if sigma_m is not None:
                    self._plot(entity, 100.0 * sigma_m)
            self._say("mission", f"{progress.phase} {progress.mode}".strip())
            self._say("mission note", text_of(progress.note))
        plan = self._plan.new()
        if plan is not None:
            self._draw(rerun_archetypes.plan(plan))
            self._plot(names.PLANNING, 1e3 * plan.step_s)
            self._plot(names.PLANNING_TASKS, 1e3 * plan.task_s)
        intent = self._intent.new()
        if intent is not None:
            identifier = -1 if intent.trajectory is None else intent.trajectory.identifier
            if identifier != self._trajectory_id:  # the intent is sent at every step, but its trajectory changes rarely
                self._trajectory_id = identifier
                self._draw(rerun_archetypes.trajectory(intent.trajectory))
            self._say("intent", intent.goal.value)

    def _log_maps(self) -> None:
        voxels = self._voxels.new()
        if voxels is not None:
            self._map = voxels
            self._draw(rerun_archetypes.voxels(voxels))
        surface = self._surface.new()
        if surface is not None:
            self._draw(rerun_archetypes.surface(surface))

    def _say(self, who: str, text: str) -> None:
        """Add a line to the log if the text of a source has changed."""
        if text and self._said.get(who) != text:
            import rerun as rr

            self._draw([(f"{names.LOG}/{who.replace(' ', '_')}", rr.TextLog(f"{who}: {text}"))])
        self._said[who] = text

    def _plot(self, entity: str, value: float) -> None:
        if np.isfinite(value):
            import rerun as rr

            self._draw([(entity, rr.Scalars(value))])

    def _draw(self, drawn: rerun_archetypes.Drawing, static: bool = False) -> None:
        for stream in self._streams():
            for entity, archetype in drawn:
                stream.log(entity, archetype, static=static)

    def _set_time(self, now_s: float) -> None:
        for stream in self._streams():
            stream.set_time(names.TIMELINE, duration=now_s - self._start_s)

    def _flush(self) -> None:
        """Write to disk, so that a killed recorder loses two seconds."""
        try:
            self._file.flush(timeout_sec=_FLUSH_TIMEOUT_S)
        except RuntimeError as error:
            _LOG.warning("%s: %s", self._folder / names.RECORDING, error)

    def _streams(self) -> list[Any]:
        return [self._file] if self._live is None or self._live.ended else [self._file, self._live.stream]


def _distance_m(voxels: VoxelMap, position_world: FloatArray) -> float | None:
    """Return the map's distance to the nearest voxel not known free; None outside the map."""
    index = voxels.grid.index(position_world)
    return float(voxels.distance_m(index)) if bool(voxels.grid.contains(index)) else None
