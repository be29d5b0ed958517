"""`uav-recon track`: a tracking engine of others beside the camera stream, in this process."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from uav_recon.app import camera_sources, config_file, processes, systemd_notify
from uav_recon.app.option_validation import UsageError, readable
from uav_recon.clock import MonotonicClock, RateKeeper
from uav_recon.config import Config
from uav_recon.errors import UserError
from uav_recon.interfaces import Clock
from uav_recon.sensors.stream_camera import open_stream, read_intrinsics
from uav_recon.sensors.stream_format import StreamError
from uav_recon.trackers.engine import TrackerError, TrackingEngine
from uav_recon.trackers.tracker_process import TrackerProcess
from uav_recon.types.camera import Intrinsics

LOG = logging.getLogger(__name__)

POLL_HZ = 200.0
STATUS_S = 10.0


@dataclass(frozen=True)
class TrackOptions:
    """engine: orbslam3, cuvslam or droid. weights: its vocabulary or weights, None for none."""

    engine: str
    config: Path
    weights: Path | None = None


def track(options: TrackOptions, stopped: Callable[[], bool]) -> int:
    """Track until stopped(); returns exit code 0.

    Raises UserError with one line: no stream, an engine that is not installed, weights that are missing or wrong.
    """
    opener = _checked_opener(options)
    config, clock = config_file.load_config(options.config), MonotonicClock()
    _check(config)
    processes.claim("tracker", config)
    path = camera_sources.stream_path(config)
    try:
        reader = open_stream(path, clock, camera_sources.CAMERA_WAIT_S, stopped)
        engine = opener(read_intrinsics(reader, path)[1])
    except (StreamError, TrackerError) as error:
        raise UserError(str(error), 0 if stopped() else None) from None
    try:
        tracker = TrackerProcess(path, engine, camera_sources.tilted_camera(config), clock)
        systemd_notify.ready()
        _loop(tracker, clock, stopped)
    except StreamError as error:
        raise UserError(str(error)) from None
    finally:
        engine.close()
    return 0


def _loop(tracker: TrackerProcess, clock: Clock, stopped: Callable[[], bool]) -> None:
    rate, status = RateKeeper(POLL_HZ, clock.now_s()), RateKeeper(1.0 / STATUS_S, clock.now_s() + STATUS_S)
    while not stopped():
        tracker.step()
        if status.due(clock.now_s()):
            LOG.info("%d poses written", tracker.poses)
        rate.due(clock.now_s())
        clock.sleep_until(rate.next_s())


def _checked_opener(options: TrackOptions) -> Callable[[Intrinsics], TrackingEngine]:
    """Return what opens the engine.

    Raises UserError for a file that is missing, before anybody waits for a camera.
    """
    opener = _opener(options)
    if options.weights is not None and options.engine != "cuvslam":
        with readable(f"--weights {options.weights}"):
            options.weights.open("rb").close()
    return opener


def _opener(options: TrackOptions) -> Callable[[Intrinsics], TrackingEngine]:
    """Return what opens the engine on a camera. Raises UsageError for options that do not fit."""
    weights = options.weights
    if options.engine == "cuvslam":
        from uav_recon.trackers.cuvslam import CuVslam

        return CuVslam
    if options.engine not in ("orbslam3", "droid"):
        raise UsageError(f"ENGINE {options.engine}: want one of orbslam3, cuvslam, droid")
    if weights is None:
        what = "the path of ORBvoc.txt" if options.engine == "orbslam3" else "the path of droid.pth"
        raise UsageError(f"--weights: want {what}")
    if options.engine == "orbslam3":
        from uav_recon.trackers.orbslam3 import OrbSlam3

        return lambda camera: OrbSlam3(weights, camera)
    from uav_recon.trackers.droid import Droid

    return lambda camera: Droid(weights, camera)


def _check(config: Config) -> None:
    """Raise UserError for a config with which nobody would read the poses, or the mount moves."""
    if (config.camera.source, config.localization.source) != ("stream", "stream"):
        raise UserError("config: want camera.source and localization.source stream: the engine works on the camera stream")
    if config.camera.mount != "fixed":
        raise UserError("config: want camera.mount fixed: the engine is not told the angle of a gimbal")
