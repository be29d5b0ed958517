"""`uav-recon calibrate`: options, input and output of a calibration by hand."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import tomli_w
from rich.console import Console
from rich.table import Table

from uav_recon import config as configuration
from uav_recon.app import camera_sources, config_file, pose_sources
from uav_recon.app.flight_channels import read_only_channels
from uav_recon.app.option_validation import UsageError, require_writable_file, require_writable_folder
from uav_recon.app.recording_options import require_depth_unit
from uav_recon.app.recording_remarks import print_remarks, recording_remarks, skipped_remarks
from uav_recon.app.step_display import StepDisplay
from uav_recon.clock import ManualClock, MonotonicClock
from uav_recon.config import Config
from uav_recon.errors import EXIT_CONFIG, UserError
from uav_recon.interfaces import DepthCamera, PoseSource
from uav_recon.sensors.npz_recording import NpzRecording
from uav_recon.sensors.recordings.checked_recording import CheckedRecording
from uav_recon.sensors.recordings.detection import ReadOptions, open_recording
from uav_recon.sensors.recordings.recording import LEVEL_MOUNT, PlaybackCamera, PlaybackPoses
from uav_recon.sensors.stream_format import StreamError
from uav_recon.types.camera import BODY_FROM_OPTICAL
from uav_recon.types.camera_calibration import ERROR_SIGMAS, HIDDEN_BY_OWN_POSES, CameraCalibration
from uav_recon.types.pose import Pose

if TYPE_CHECKING:  # the kernels are compiled only for a calibration
    from uav_recon.localization.calibration.calibration_filter import Elements
    from uav_recon.localization.hand_calibration import CameraCalibrator

_STEP_S = 0.01
_SAID_S = 2.0  # between two lines of advice
_SECONDS = (5.0, 600.0)
_SILENT_S = 10.0  # without a frame or a pose for this time after the start nothing can be calibrated
_AFTER_S = 1.0  # after the last frame, for the pose that follows it
PLOT = "calibration.png"


@dataclass(frozen=True)
class CalibrateOptions:
    """The validated options.

    recording None: live, for at most seconds. depth_unit_m: of the recording; None: its own.
    """

    recording: Path | None
    config: Path
    seconds: float
    out: Path
    write: Path | None
    depth_unit_m: float | None = None

    @staticmethod
    def of(
        recording: Path | None,
        live: bool,
        config: Path,
        seconds: float,
        out: Path,
        write: Path | None,
        depth_unit_m: float | None = None,
    ) -> CalibrateOptions:
        """Validate the options. Raises UsageError with one line."""
        if (recording is None) != live:
            raise UsageError("want a RECORDING or --live, one of both")
        if not _SECONDS[0] <= seconds <= _SECONDS[1]:
            raise UsageError(f"--seconds {seconds:g}: want {_SECONDS[0]:g} to {_SECONDS[1]:g}")
        require_depth_unit(depth_unit_m)
        if live and depth_unit_m is not None:
            raise UsageError("--depth-unit: want a RECORDING; a camera tells its own unit")
        require_writable_file("--write", write)
        require_writable_folder("--out", out)
        return CalibrateOptions(recording, config, seconds, out, write, depth_unit_m)


def calibrate(options: CalibrateOptions) -> int:
    """Estimate, print the table and the config lines, draw the residuals.

    Exit code 0: all elements are known; 1: some are not, and the motions that would show them are printed. Raises UserError
    with one line for input that cannot be used.
    """
    from uav_recon.localization.hand_calibration import known_elements
    from uav_recon.mapping.neural.keyframes.joint_adjustment import calibration_of
    from uav_recon.recording.calibration_plot import residuals_over_time

    config, console = config_file.load_config(options.config), Console()
    if config.camera.mount == "gimbal":
        raise UserError("camera.mount gimbal: only a fixed mount can be calibrated by hand; a gimbal is in flight", EXIT_CONFIG)
    walk = _from_recording(options, config, console) if options.recording is not None else _live(options, config, console)
    calibrator = walk.calibrator
    if not calibrator.frames:
        raise UserError(f"no frame with a pose at its stamp ({calibrator.poses_read} poses were read)")
    elements = _elements(walk, config, console)
    known = {name: value for name, value, _ in known_elements(elements)}
    console.print(_table(elements, set(known)))
    calibration = calibration_of(np.array([known.get(name, 0.0) for name in ERROR_SIGMAS]))
    before, after = calibrator.residuals(CameraCalibration.none()), calibrator.residuals(calibration)
    series = {
        f"before, median {1e3 * before.typical_m:.1f} mm": (before.stamp_s, before.distance_m),
        f"after, median {1e3 * after.typical_m:.1f} mm": (after.stamp_s, after.distance_m),
    }
    residuals_over_time(options.out / PLOT, series)
    lines = config_lines(config, calibration)
    console.print(
        f"residuals: {1e3 * before.typical_m:.1f} mm before, {1e3 * after.typical_m:.1f} mm after, {options.out / PLOT}"
    )
    console.print("\nwrite into the config:\n", highlight=False)
    console.print(tomli_w.dumps({"camera": lines}), markup=False, highlight=False)
    if options.write is not None:
        _write(config, lines, options.write)
        console.print(f"written: {options.write}")
    missing = walk.missing(elements)
    for motion in missing:
        console.print(f"not known yet: {motion}")
    if walk.own_poses:
        console.print("not known: delay, mount and depth scale: the poses come from the depth images and have these errors too")
    return 1 if missing or walk.own_poses else 0


def config_lines(config: Config, calibration: CameraCalibration) -> dict[str, Any]:
    """Return the keys of [camera] that remove the errors of a fixed mount."""
    camera = config.camera
    true = camera_sources.tilted_camera(config) @ calibration.nominal_from_true
    level = true.rotation() @ BODY_FROM_OPTICAL[:3, :3].T  # Rz(yaw) Ry(pitch down) Rx(roll)
    yaw, pitch = math.atan2(level[1, 0], level[0, 0]), math.asin(max(min(-float(level[2, 0]), 1.0), -1.0))
    roll = math.atan2(level[2, 1], level[2, 2])
    return {
        "pitch_down_deg": round(math.degrees(pitch), 2),
        "roll_deg": round(math.degrees(roll), 2),
        "yaw_deg": round(math.degrees(yaw), 2),
        "position_body_m": [round(x, 4) for x in true.translation_m.tolist()],
        "delay_s": round(camera.delay_s + calibration.delay_s, 4),
        "depth_scale": round((1.0 + camera.depth_scale) * (1.0 + calibration.scale) - 1.0, 4),
    }


class _Walk(NamedTuple):
    """A walk that was read.

    own_poses: the poses come from the depth images, which then show neither delay nor mount nor scale of depth.
    """

    calibrator: CameraCalibrator
    own_poses: bool

    def missing(self, elements: Elements) -> list[str]:
        """Return the motions that would show what is not known yet."""
        from uav_recon.localization.hand_calibration import missing_motions

        motions = missing_motions(elements)
        return [motion for name, motion in motions.items() if not (self.own_poses and name in HIDDEN_BY_OWN_POSES)]


class _Source(NamedTuple):
    """Camera and poses of a recording, its first and last instant, and the reader.

    recording: None for an .npz file.
    """

    camera: DepthCamera
    poses: PoseSource
    begin_s: float
    end_s: float
    recording: CheckedRecording | None = None


def _from_recording(options: CalibrateOptions, config: Config, console: Console) -> _Walk:
    from uav_recon.localization.calibration.camera_mount import FixedMount
    from uav_recon.localization.hand_calibration import CameraCalibrator
    from uav_recon.sensors.corrected_camera import CorrectedCamera

    assert options.recording is not None
    clock, mount = ManualClock(-math.inf), FixedMount(camera_sources.tilted_camera(config))
    try:
        source = _open_recording(options.recording, options.depth_unit_m, config, clock, console)
        camera = CorrectedCamera(source.camera, config.camera.delay_s, config.camera.depth_scale)
        calibrator = CameraCalibrator(camera, source.poses, mount, clock)
        for step in range(math.ceil((source.end_s - source.begin_s) / _STEP_S) + 2):
            clock.advance_to(source.begin_s + step * _STEP_S)
            calibrator.step()
        if source.recording is not None:
            print_remarks(skipped_remarks(source.recording.info), console)
    except StreamError as error:
        raise UserError(str(error)) from None
    return _Walk(calibrator, own_poses=False)


def _open_recording(path: Path, depth_unit_m: float | None, config: Config, clock: ManualClock, console: Console) -> _Source:
    """Open a recording, and print what the user should know of it.

    It is an .npz file, or a ROS 2 bag with the poses of a body that carries the camera, as `uav-recon record` writes. Raises
    StreamError and UserError.
    """
    span_m = config.camera.depth_min_m, config.camera.depth_max_m
    if path.suffix == ".npz":
        source = NpzRecording(path, clock, *span_m, depth_unit_m)
        return _Source(source, source, source.begin_s, source.end_s)
    recording = open_recording(path, ReadOptions(*span_m, metres_per_unit=depth_unit_m))
    info, poses = recording.info, recording.poses()
    found = "".join(f"; {remark}" for remark in info.remarks)
    if not poses:
        raise UserError(f"{path}: {info.kind} without poses{found}: the camera is calibrated against the poses of the vehicle")
    if info.body_from_depth is LEVEL_MOUNT:
        raise UserError(
            f"{path}: {info.kind} with poses of the camera{found}: want those of the vehicle, as `uav-recon record` writes"
        )
    print_remarks(recording_remarks(recording), console)
    clock.advance_to(info.first_s)
    camera = PlaybackCamera(recording, clock)
    playback = PlaybackPoses(recording, clock, camera.shift_s, Pose.identity())
    return _Source(camera, playback, info.first_s, info.last_s + _AFTER_S, recording)  # later poses have no frame


def _live(options: CalibrateOptions, config: Config, console: Console) -> _Walk:
    from uav_recon.localization.calibration.camera_mount import FixedMount
    from uav_recon.localization.hand_calibration import CameraCalibrator

    clock, mount = MonotonicClock(), FixedMount(camera_sources.tilted_camera(config))
    camera = camera_sources.open_camera(config, clock)
    context = pose_sources.SourceContext(config, read_only_channels(config.runtime.folder), clock, camera, mount)
    opened = pose_sources.open_poses(context)
    calibrator = CameraCalibrator(opened.camera, opened.poses, mount, clock, opened.view)
    walk = _Walk(calibrator, config.localization.source == "slam")
    begin_s = said_s = clock.now_s()
    console.print("move the vehicle by hand; Ctrl-C ends")
    try:
        while (now_s := clock.now_s()) - begin_s < options.seconds:
            calibrator.step()
            missing = walk.missing(calibrator.elements())
            if not missing and not walk.own_poses:
                break
            if not calibrator.frames and now_s - begin_s > _SILENT_S:
                raise UserError(f"no frame with a pose in {_SILENT_S:g} s ({calibrator.poses_read} poses were read)")
            if now_s - said_s >= _SAID_S:
                said_s = now_s
                console.print(f"{now_s - begin_s:4.0f} s  {calibrator.frames} frames  {missing[0] if missing else ''}")
            clock.sleep_until(now_s + _STEP_S)
    except KeyboardInterrupt:
        console.print("ended")
    finally:
        opened.camera.close()
    return walk


def _elements(walk: _Walk, config: Config, console: Console) -> Elements:
    """Return the errors that all views show together.

    With too few views they are those of the filter, and a line says so.
    """
    from uav_recon.app.views_calibration import errors_from_views

    views = walk.calibrator.views
    with StepDisplay(console).step(f"comparing {len(views)} views") as report:
        found = errors_from_views(views, config.camera, own_poses=walk.own_poses, report=report)
    if found is None:
        console.print("too few views can be compared; these errors are from neighbouring frames alone and less certain:")
        return tuple(each for each in walk.calibrator.elements() if not (walk.own_poses and each[0] in HIDDEN_BY_OWN_POSES))
    return found


def _table(elements: Elements, known: set[str]) -> Table:
    table = Table("element", "value", "sigma", "known")
    for name, value, sigma in elements:
        degrees = name.endswith("_rad")
        shown, unit = (name.removesuffix("_rad"), math.degrees(1.0)) if degrees else (name, 1.0)
        mark = "yes" if name in known else "no"
        table.add_row(shown + ("_deg" if degrees else ""), f"{unit * value:.4f}", f"{unit * sigma:.4f}", mark)
    return table


def _write(config: Config, lines: dict[str, Any], path: Path) -> None:
    """Write the effective config with these keys.

    Raises UserError if they are outside the config's ranges.
    """
    tree = config.model_dump(mode="json", exclude_none=True)
    tree["camera"] |= lines
    try:
        configuration.save(configuration.parse(tree, "calibrated"), path)
    except configuration.ConfigError as error:
        raise UserError(str(error), EXIT_CONFIG) from None
