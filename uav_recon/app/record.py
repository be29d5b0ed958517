"""`uav-recon record`: write what the camera gives to a recording."""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from uav_recon.app import camera_sources, config_file, pose_sources
from uav_recon.app.flight_channels import read_only_channels
from uav_recon.app.option_validation import UsageError, require_writable_file
from uav_recon.clock import MonotonicClock, RateKeeper
from uav_recon.config import Config
from uav_recon.errors import UserError
from uav_recon.interfaces import Clock, DepthCamera, PoseSource
from uav_recon.localization.calibration.camera_mount import FixedMount
from uav_recon.sensors.recordings.mcap_writer import McapWriter
from uav_recon.sensors.recordings.recording import RecordingError
from uav_recon.sensors.recordings.recording_sources import CameraSource, RecordingSource, StreamSource, header_of
from uav_recon.sensors.stream_camera import open_stream
from uav_recon.sensors.stream_format import StreamError, StreamHeader
from uav_recon.types.camera import Frame

POLL_HZ = 200.0  # the stream keeps four frames: no frame is missed below 50 frames a second
STATUS_S = 5.0
FREE_BYTES = 500_000_000  #: refuse: recording ends while this much of the disk is still free
SILENT_S = 10.0  #: refuse: recording ends after this time without any record of the stream


@dataclass(frozen=True)
class RecordOptions:
    """out: the file. max_gb: its size at most. seconds: time at most."""

    config: Path
    out: Path
    max_gb: float = 20.0
    seconds: float = math.inf


def record(options: RecordOptions, console: Console, stopped: Callable[[], bool]) -> int:
    """Record until stopped(), a limit, or the end of the camera; returns exit code 0.

    Raises UserError with one line.
    """
    if options.out.suffix != ".mcap":
        raise UsageError(f"OUT {options.out}: want a name that ends in .mcap")
    if options.out.exists():
        raise UsageError(f"OUT {options.out}: exists already")
    require_writable_file("OUT", options.out)
    config, clock = config_file.load_config(options.config), MonotonicClock()
    try:
        source, header = open_source(config, clock, stopped)
        writer = McapWriter(options.out, header, camera_sources.tilted_camera(config), int(options.max_gb * 1e9))
    except (StreamError, RecordingError) as error:
        raise UserError(str(error), 0 if stopped() else None) from None
    except OSError as error:
        raise UserError(f"{options.out}: cannot be written ({error.strerror})") from None
    recorder = SensorRecorder(source, writer, options.out.parent, clock, options.seconds)
    try:
        _loop(recorder, clock, stopped, lambda: console.print(recorder.status(), highlight=False, markup=False))
    except OSError as error:
        raise UserError(f"{options.out}: cannot be written ({error.strerror})") from None
    finally:
        source.close()
        writer.close()
    console.print(f"{options.out}: {recorder.status()}; {recorder.ended or 'stopped'}", highlight=False, markup=False)
    return 0


def open_source(config: Config, clock: Clock, stopped: Callable[[], bool]) -> tuple[RecordingSource, StreamHeader]:
    """Open what is recorded, and return it with its constants; a camera is waited for.

    A camera that is read directly gives its frames as they are, without the corrections of the config, and the poses of the
    config's source. The embedded SLAM's are left out, because `uav-recon replay --pose slam` makes them from the recording.
    Raises UserError or StreamError with one line.
    """
    if config.camera.source == "stream":
        reader = open_stream(camera_sources.stream_path(config), clock, camera_sources.CAMERA_WAIT_S, stopped)
        return StreamSource(reader), reader.header
    as_it_is = config.camera.model_copy(update={"delay_s": 0.0, "depth_scale": 0.0})
    camera = camera_sources.open_camera(config.model_copy(update={"camera": as_it_is}), clock, stopped)
    try:
        first = _first_frame(camera, clock, stopped)
        return CameraSource(camera, _poses(config, clock, camera), first), header_of(first)
    except UserError:
        camera.close()
        raise


def _first_frame(camera: DepthCamera, clock: Clock, stopped: Callable[[], bool]) -> Frame:
    begun_s = clock.now_s()
    while (frame := camera.poll()) is None:
        if stopped():
            raise UserError("stopped before the first frame", 0)
        if clock.now_s() - begun_s >= SILENT_S:
            raise UserError(f"the camera gave no frame in {SILENT_S:g} s")
        clock.sleep_until(clock.now_s() + 1.0 / POLL_HZ)
    return frame


def _poses(config: Config, clock: Clock, camera: DepthCamera) -> PoseSource | None:
    if config.localization.source == "slam":
        return None
    mount, channels = FixedMount(camera_sources.tilted_camera(config)), read_only_channels(config.runtime.folder)
    return pose_sources.open_poses(pose_sources.SourceContext(config, channels, clock, camera, mount)).poses


class SensorRecorder:
    """Copy of a source into a recording. ``ended``: reason of the end, '' before it."""

    def __init__(self, source: RecordingSource, writer: McapWriter, folder: Path, clock: Clock, seconds: float) -> None:
        self._source, self._writer, self._folder, self._clock = source, writer, folder, clock
        self._begun_s = self._newest_s = clock.now_s()
        self._seconds = seconds
        self.ended = ""

    def step(self) -> None:
        """Write what is new."""
        if self.ended:
            return
        new = self._source.copy_to(self._writer)
        now_s = self._clock.now_s()
        if new:
            self._newest_s = now_s
        self.ended = self._why_end(now_s)

    def status(self) -> str:
        """Return what was recorded, with rate and size, as one line."""
        span_s = max(self._clock.now_s() - self._begun_s, 1e-9)
        size_mb, missed = self._writer.size_bytes / 1e6, f", {self._source.missed} missed" if self._source.missed else ""
        return (
            f"{span_s:.0f} s, {self._writer.frames} frames ({self._writer.frames / span_s:.1f}/s{missed}), "
            f"{self._writer.imu} inertial samples, {self._writer.poses} poses, {size_mb:.0f} MB ({size_mb / span_s:.1f} MB/s)"
        )

    def _why_end(self, now_s: float) -> str:
        if self._writer.full:
            return "--max-gb is reached"
        if now_s - self._begun_s >= self._seconds:
            return "--seconds is reached"
        if now_s - self._newest_s >= SILENT_S:
            return f"the camera was silent for {SILENT_S:g} s"
        if shutil.disk_usage(self._folder).free < FREE_BYTES:
            return f"less than {FREE_BYTES / 1e6:.0f} MB of the disk is free"
        return ""


def default_name() -> Path:
    """Return a dated file name in the present folder."""
    return Path(f"recording-{time.strftime('%Y%m%d-%H%M%S')}.mcap")


def _loop(recorder: SensorRecorder, clock: MonotonicClock, stopped: Callable[[], bool], say: Callable[[], None]) -> None:
    rate, status = RateKeeper(POLL_HZ, clock.now_s()), RateKeeper(1.0 / STATUS_S, clock.now_s() + STATUS_S)
    while not (stopped() or recorder.ended):
        recorder.step()
        if status.due(clock.now_s()):
            say()
        rate.due(clock.now_s())
        clock.sleep_until(rate.next_s())
