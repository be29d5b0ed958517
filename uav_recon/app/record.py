"""`uav-recon record`: write the camera stream that perception reads to a recording."""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from uav_recon.app import camera_sources, factory
from uav_recon.app.option_validation import UsageError, require_writable_file
from uav_recon.clock import MonotonicClock, RateKeeper
from uav_recon.errors import UserError
from uav_recon.interfaces import Clock
from uav_recon.sensors.recordings.mcap_writer import McapWriter
from uav_recon.sensors.recordings.recording import RecordingError
from uav_recon.sensors.stream_camera import open_stream
from uav_recon.sensors.stream_format import StreamError, StreamReader
from uav_recon.types.pose import Pose

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
    config, clock = factory.load_config(options.config), MonotonicClock()
    try:
        reader = open_stream(camera_sources.stream_path(config), clock, camera_sources.CAMERA_WAIT_S, stopped)
        mount = camera_sources.tilted_camera(config)
        writer = McapWriter(options.out, reader.header, mount, int(options.max_gb * 1e9))
    except (StreamError, RecordingError) as error:
        raise UserError(str(error), 0 if stopped() else None) from None
    except OSError as error:
        raise UserError(f"{options.out}: cannot be written ({error.strerror})") from None
    recorder = StreamRecorder(reader, writer, options.out.parent, clock, options.seconds)
    try:
        _loop(recorder, clock, stopped, lambda: console.print(recorder.status(), highlight=False, markup=False))
    except OSError as error:
        raise UserError(f"{options.out}: cannot be written ({error.strerror})") from None
    finally:
        writer.close()
    console.print(f"{options.out}: {recorder.status()}; {recorder.ended or 'stopped'}", highlight=False, markup=False)
    return 0


class StreamRecorder:
    """Copy of a stream into a recording. ``ended``: reason of the end, '' before it."""

    def __init__(self, reader: StreamReader, writer: McapWriter, folder: Path, clock: Clock, seconds: float) -> None:
        self._reader, self._writer, self._folder, self._clock = reader, writer, folder, clock
        self._frame = self._imu = self._pose = 0
        self._begun_s = self._newest_s = clock.now_s()
        self._seconds = seconds
        self.missed = 0
        self.ended = ""

    def step(self) -> None:
        """Write every new record; at most one frame, because the stream gives the newest."""
        if self.ended:
            return
        before = self._frame, self._imu, self._pose
        self._imu, samples = self._reader.imu(self._imu)
        for sample in samples:
            self._writer.write_imu(float(sample["stamp_s"]), sample["gyro_radps"], sample["specific_force_mps2"])
        self._pose, poses = self._reader.poses(self._pose)
        for pose in poses:
            self._write_pose(pose)
        raw = self._reader.frame(self._frame)
        if raw is not None:
            self.missed += raw.sequence - self._frame - 1 if self._frame else 0
            self._frame = raw.sequence
            self._writer.write_frame(raw.stamp_s, raw.depth_mm, raw.rgb)
        now_s = self._clock.now_s()
        if (self._frame, self._imu, self._pose) != before:
            self._newest_s = now_s
        self.ended = self._why_end(now_s)

    def status(self) -> str:
        """Return what was recorded, with rate and size, as one line."""
        span_s = max(self._clock.now_s() - self._begun_s, 1e-9)
        size_mb, missed = self._writer.size_bytes / 1e6, f", {self.missed} missed" if self.missed else ""
        return (
            f"{span_s:.0f} s, {self._writer.frames} frames ({self._writer.frames / span_s:.1f}/s{missed}), "
            f"{self._writer.imu} inertial samples, {self._writer.poses} poses, {size_mb:.0f} MB ({size_mb / span_s:.1f} MB/s)"
        )

    def _write_pose(self, pose: np.void) -> None:
        numbers = np.concatenate([pose["quat_wxyz"], pose["position_m"], pose["variance"]])
        if int(pose["quality"]) > 0 and np.isfinite(numbers).all() and np.linalg.norm(pose["quat_wxyz"]) > 0.5:
            pose_of_body = Pose(np.array(pose["quat_wxyz"]), np.array(pose["position_m"]))
            self._writer.write_pose(float(pose["stamp_s"]), pose_of_body, pose["variance"])

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


def _loop(recorder: StreamRecorder, clock: MonotonicClock, stopped: Callable[[], bool], say: Callable[[], None]) -> None:
    rate, status = RateKeeper(POLL_HZ, clock.now_s()), RateKeeper(1.0 / STATUS_S, clock.now_s() + STATUS_S)
    while not (stopped() or recorder.ended):
        recorder.step()
        if status.due(clock.now_s()):
            say()
        rate.due(clock.now_s())
        clock.sleep_until(rate.next_s())
