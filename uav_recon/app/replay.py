"""`uav-recon replay`: perception, maps and planner over a recording.

The clock is manual, so it runs as fast as the machine allows. The objects are those of a flight; only camera and poses come
from the recording, and nothing is flown: views are the frames that show enough that is new, and the planner is asked from where
the camera was.
"""

from __future__ import annotations

import json
import math
import time
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from uav_recon import config as configuration
from uav_recon.app import mapper_factory, mission_factory, pose_sources
from uav_recon.app.flight_channels import FlightChannels, memory_channels
from uav_recon.app.option_validation import OUTPUTS, UsageError, readable, remove_outputs, require_writable_folder
from uav_recon.app.pose_sources import OpenedPoses
from uav_recon.app.recording_remarks import print_remarks, recording_remarks
from uav_recon.app.recording_survey import UPS, RecordingSurvey, survey_recording
from uav_recon.app.reference_safety import REFERENCE_SAFETY
from uav_recon.app.step_display import Report, StepDisplay
from uav_recon.clock import ManualClock, RateKeeper
from uav_recon.config import Config, ConfigError, parse
from uav_recon.errors import EXIT_CONFIG, UserError
from uav_recon.interfaces import Mapper, PoseSource
from uav_recon.localization.calibration.camera_mount import FixedMount
from uav_recon.localization.perception.perception import Perception
from uav_recon.mission.log.mission_log import MissionLog
from uav_recon.mission.log.perception_log import PerceptionLog
from uav_recon.mission.state_machine import Phase
from uav_recon.recording.flight_log import FlightLog
from uav_recon.sensors.recordings.detection import ReadOptions, open_recording
from uav_recon.sensors.recordings.recording import PlaybackCamera, PlaybackPoses, Recording, RecordingError, RecordingInfo
from uav_recon.types.camera import PosedFrame
from uav_recon.types.maps import SurfaceElements, VoxelMap
from uav_recon.types.pose import MapCorrection, Pose, PoseHealth
from uav_recon.types.tasks import PlanRequest

MAPPERS = ("neural", "none")
FROM_RECORDING = "recording"
POSES = (FROM_RECORDING, "slam")
TRAJECTORY = "trajectory.txt"
SUMMARY = "replay.json"
START_S = 1000.0
STEP_S = 0.01  # perception runs at 100 Hz, as in a flight
DRAIN_S = 1.0  # after the last frame, until every frame that waits for a pose is decided
PLAN_HZ = 0.5
PROGRESS_HZ = 5.0
_BODY_RADIUS_M = 0.2  #: plan: the space of this radius around the camera's path counts as free: it was there
_BODY_HALF_M = 0.15
_FREE_STEP_M = 0.2
_FIRST_VIEWS = 4  #: plan: views that may be taken at once; the others are spread over the recording
_ANY_GAIN = 10**6  #: plan: views left, as given to the keyframe selection: any view with the smallest gain is worth it


@dataclass(frozen=True)
class ReplayOptions:
    """The options of the command.

    pose: "recording" or a value of localization.source. up: see survey_recording.
    """

    source: Path
    out: Path
    read: ReadOptions = field(default_factory=ReadOptions)
    pose: str = FROM_RECORDING
    mapper: str = "neural"
    up: str = "auto"
    views: int = 60

    def check(self) -> None:
        """Raise UsageError for a value that cannot be used."""
        for name, value, allowed in (("pose", self.pose, POSES), ("mapper", self.mapper, MAPPERS), ("up", self.up, UPS)):
            if value not in allowed:
                raise UsageError(f"--{name} {value}: want one of {', '.join(allowed)}")
        with readable(f"--out {self.out}"):
            if self.source.exists() and self.out.exists() and self.out.samefile(self.source):
                raise UsageError(f"--out {self.out}: is the recording itself; name another folder")
            if taken := next((name for name in OUTPUTS if (self.out / name).exists()), None):
                raise UsageError(f"--out {self.out}: already contains {taken}; name another folder")


@dataclass
class ReplaySummary:
    """Figures of a replay, as in replay.json.

    frames_read: given to perception. frames_used: given on with a pose. refused: by reason as text. drift_alarms: how often
    odometry became wrong; alarm_s: time in that state. calibration: (name, value, standard deviation).
    """

    source: str
    kind: str
    frames_in_recording: int
    frames_read: int = 0
    frames_used: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    drift_alarms: int = 0
    alarm_s: float = 0.0
    lost_s: float = 0.0
    alarms: dict[str, int] = field(default_factory=dict)
    resets: int = 0
    calibration: list[tuple[str, float, float]] = field(default_factory=list)
    imu_samples: int = 0
    recorded_s: float = 0.0
    skipped: dict[str, int] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)
    path_length_m: float = 0.0
    explored_m3: float = 0.0
    views: int = 0
    plans: int = 0
    wall_s: float = 0.0


class NoMapper:
    """Mapper that learns nothing: for replays of perception and occupancy map alone."""

    def add(self, keyframe: PosedFrame) -> bool:
        """Accept the keyframe."""
        return True

    def repose(self, correction: MapCorrection) -> None:
        """Do nothing."""

    def surface(self) -> SurfaceElements | None:
        """Return None."""
        return None

    def refused(self) -> dict[str, int]:
        """Return no rejections."""
        return {}

    def alive(self) -> bool:
        """Return True."""
        return True

    def finish(self, folder: Path) -> None:
        """Do nothing: there is no mesh."""


class _Mapping:
    """Occupancy map, mapper and planner over the frames that perception gives on."""

    def __init__(self, config: Config, channels: FlightChannels, mapper: Mapper, journal: FlightLog) -> None:
        self._channels = channels
        self.mapper = mapper
        self._voxels = mission_factory.make_occupancy_map(config)
        self._planner = mission_factory.make_planner(config, time.perf_counter)
        self._budget = mission_factory.make_keyframe_selection(config, self._voxels.grid)
        self.log = MissionLog(journal, config.mission.views)
        self._sequence = 0
        self._freed_m = np.full(3, np.inf)
        self._share = 0.0
        self._body = Pose.identity()
        self.path_m: list[np.ndarray[tuple[int, ...], np.dtype[np.float64]]] = []
        self.posed: list[tuple[float, Pose]] = []
        self._plan_rate, self._progress_rate = RateKeeper(PLAN_HZ, START_S), RateKeeper(PROGRESS_HZ, START_S)

    def step(self, now_s: float, body_from_depth: Pose, share: float) -> None:
        """Map the newest frame, plan, and log the progress.

        share: of the recording that has been read, 0 to 1.
        """
        self._share = share
        sequence = self._channels.frames.sequence()
        posed = self._channels.frames.latest() if sequence != self._sequence else None
        self._sequence = sequence
        if posed is not None and not posed.unsure:
            self._map(posed, posed.world_from_depth @ body_from_depth.inverse())
        if self.path_m and self._plan_rate.due(now_s):
            self._plan(now_s)
        if self._progress_rate.due(now_s):
            self.report(now_s, finished=False)

    def report(self, now_s: float, *, finished: bool) -> None:
        """Log the progress."""
        here = self.path_m[-1] if self.path_m else np.zeros(3)
        phase = Phase.DONE if finished else Phase.SURVEY
        self.log.progress(now_s, phase, self.explored_m3(), self.path_length_m(), here, finished)

    def snapshot(self) -> VoxelMap:
        """Return the occupancy map."""
        return self._voxels.snapshot()

    def explored_m3(self) -> float:
        """Return the known volume."""
        return self._voxels.explored_m3()

    def path_length_m(self) -> float:
        """Return the length of the camera's path."""
        return float(np.linalg.norm(np.diff(self.path_m, axis=0), axis=1).sum()) if len(self.path_m) > 1 else 0.0

    def _map(self, posed: PosedFrame, world_from_body: Pose) -> None:
        here = world_from_body.translation_m
        self.path_m.append(here)
        self.posed.append((posed.frame.stamp_s, posed.world_from_depth))
        self._body = world_from_body
        if not np.linalg.norm(here - self._freed_m) < _FREE_STEP_M:
            self._freed_m = here
            self._voxels.declare_free(here, _BODY_RADIUS_M, float(here[2]) - _BODY_HALF_M, float(here[2]) + _BODY_HALF_M)
        self._voxels.integrate(posed)
        due = self.log.views < _FIRST_VIEWS + self._share * (self.log.views_budget - _FIRST_VIEWS)
        if due and self._budget.selects(posed, _ANY_GAIN, explored=False) and self.mapper.add(posed):
            self._budget.keep(posed)
            self.log.view(posed)

    def _plan(self, now_s: float) -> None:
        request = PlanRequest(
            self._voxels.snapshot(), self.mapper.surface(), self._body.translation_m, self._body.yaw_rad(),
            max(self.log.views_left, 1), keyframes=tuple(self.log.keyframes),
        )  # fmt: skip
        self.log.plan(now_s, self._planner.plan(request), 0.0)


class _Alarms:
    """Counts of odometry that is wrong or lost, by reason."""

    def __init__(self, channels: FlightChannels) -> None:
        self._channels = channels
        self._before = PoseHealth.GOOD
        self._sequence = 0
        self.reasons: Counter[str] = Counter()
        self.begun = self.resets = 0
        self.wrong_s = self.lost_s = 0.0

    def step(self) -> None:
        """Read the newest odometry; called every STEP_S."""
        odom = self._channels.odom.latest()
        if odom is None:
            self.lost_s += STEP_S
            return
        self.resets = odom.reset_counter
        self.wrong_s += STEP_S * (odom.health is PoseHealth.WRONG)
        self.lost_s += STEP_S * (odom.health is PoseHealth.LOST or odom.quality == 0)
        if odom.health is PoseHealth.WRONG and self._before is not PoseHealth.WRONG:
            self.begun += 1
            self.reasons[odom.health_reason.code.value if odom.health_reason else ""] += 1
        self._before = odom.health


def replay(options: ReplayOptions, console: Console) -> int:
    """Replay a recording and write its results to options.out; returns exit code 0.

    A replay that fails or is interrupted removes what it wrote, so that it can be repeated. Raises UserError with one line.
    """
    options.check()
    display = StepDisplay(console)
    try:
        with display.step(f"looking through {options.source}"):
            recording = open_recording(options.source, options.read)
            use_poses = options.pose == FROM_RECORDING
            if use_poses and not recording.poses():
                raise UserError(_without_poses(options.source, recording.info))
            remarks = recording_remarks(recording)
        print_remarks(remarks, console)
        with display.step("choosing the box of the map"):
            survey = survey_recording(recording, options.up, use_poses=use_poses)
        require_writable_folder("--out", options.out)
        try:
            summary = _replayed(options, recording, survey, remarks, display)
        except BaseException:
            remove_outputs(options.out)
            raise
    except RecordingError as error:
        raise UserError(str(error)) from None
    _print(summary, options, console)
    return 0


def _without_poses(source: Path, info: RecordingInfo) -> str:
    found = "".join(f"; {remark}" for remark in info.remarks)
    return f"{source}: {info.kind} without poses{found}; --pose slam tracks the images instead"


def _replayed(
    options: ReplayOptions, recording: Recording, survey: RecordingSurvey, remarks: list[str], display: StepDisplay
) -> ReplaySummary:
    config = replay_config(options, recording, survey)
    configuration.save(config, options.out / "config.toml")
    with display.step("compiling kernels"):
        mission_factory.warm_up(config)
        mapper = _mapper(options.mapper, config, options.out)
    with display.step(f"replaying {options.source}") as report:
        run = _Replay(options, config, recording, survey, mapper, remarks)
        run.run(report)
    with display.step("training the final model and meshing"):
        return run.save()


class _Replay:
    """One replay. remarks: those of the recording, for its figures."""

    def __init__(
        self, options: ReplayOptions, config: Config, recording: Recording, survey: RecordingSurvey, mapper: Mapper,
        remarks: list[str],
    ) -> None:  # fmt: skip
        self._options, self._config, self._recording, self._survey = options, config, recording, survey
        self._clock, self._channels = ManualClock(START_S), memory_channels()
        self._camera = PlaybackCamera(recording, self._clock)
        mount = FixedMount(recording.info.body_from_depth)
        context = pose_sources.SourceContext(config, self._channels, self._clock, self._camera, mount)
        recorded = options.pose == FROM_RECORDING
        opened = OpenedPoses(self._camera, self._poses()) if recorded else pose_sources.open_poses(context)
        self._perception = Perception(
            config.localization, opened.camera, opened.poses, mount, self._channels, self._clock, view=opened.view
        )
        self._journal = FlightLog(options.out)
        self._perception_log = PerceptionLog(self._channels.perception, self._journal)
        self._mapping, self._alarms = _Mapping(config, self._channels, mapper, self._journal), _Alarms(self._channels)
        self._remarks, self._wall_s = remarks, time.perf_counter()

    def run(self, report: Report) -> None:
        """Step until the last frame is decided."""
        info, steps, left = self._recording.info, 0, round(DRAIN_S / STEP_S)
        self._mapping.log.phase(START_S, Phase.SURVEY)
        while left:
            steps += 1
            left -= self._camera.finished
            self._clock.advance_to(START_S + steps * STEP_S)
            self._perception.step()
            if not self._camera.finished:
                self._alarms.step()
            self._mapping.step(self._clock.now_s(), info.body_from_depth, self._camera.read / info.frames)
            self._perception_log.step(self._clock.now_s())
            report(self._camera.read, info.frames)

    def save(self) -> ReplaySummary:
        """Train the final model and write all results."""
        from uav_recon.recording.flight_report import FlightInfo, build_report, publish
        from uav_recon.recording.map_file import save_map

        out, now_s = self._options.out, self._clock.now_s()
        self._mapping.report(now_s, finished=True)
        self._perception_log.close()
        self._mapping.log.stop_reason = None
        self._mapping.log.close(now_s, None)
        save_map(out, self._mapping.snapshot())
        self._mapping.mapper.finish(out)
        self._journal.refused_views(now_s, self._mapping.mapper.refused())
        self._journal.close()
        self._write_trajectory(out / TRAJECTORY)
        summary = self._summary()
        (out / SUMMARY).write_text(json.dumps(asdict(summary), indent=1) + "\n")
        info = FlightInfo(self._options.source.name, self._config.planner.variant, "none", self._recording.info.kind)
        publish(build_report(out, info, summary.wall_s), out)
        return summary

    def _poses(self) -> PoseSource:
        return PlaybackPoses(self._recording, self._clock, self._camera.shift_s, self._survey.odom_from_source)

    def _write_trajectory(self, path: Path) -> None:
        """Write the depth imager's poses as a TUM file, in the frame and time of the recording."""
        source_from_odom, lines = self._survey.odom_from_source.inverse(), []
        for stamp_s, odom_from_depth in self._mapping.posed:
            pose = source_from_odom @ odom_from_depth
            (w, x, y, z), t = pose.quat_wxyz.tolist(), pose.translation_m.tolist()
            numbers = " ".join(f"{number:.6f}" for number in (*t, x, y, z, w))
            lines.append(f"{stamp_s - self._camera.shift_s:.6f} {numbers}\n")
        path.write_text("# stamp_s tx ty tz qx qy qz qw\n" + "".join(lines))

    def _summary(self) -> ReplaySummary:
        status, info, alarms = self._channels.perception.latest(), self._recording.info, self._alarms
        dropped = {code.value: count for code, count in self._perception.dropped_frames.items()}
        samples = {} if status is None else {k: n for k, n in status.counts().items() if k not in dropped}
        return ReplaySummary(
            str(self._options.source), info.kind, info.frames, self._camera.read, self._perception.published_frames,
            dropped | samples, alarms.begun, round(alarms.wrong_s, 2), round(alarms.lost_s, 2), dict(alarms.reasons),
            alarms.resets, [] if status is None else list(status.calibration), len(self._recording.imu()),
            info.last_s - info.first_s, dict(info.skipped), self._remarks, self._mapping.path_length_m(),
            self._mapping.explored_m3(), self._mapping.log.views, self._mapping.log.plans, time.perf_counter() - self._wall_s,
        )  # fmt: skip


def replay_config(options: ReplayOptions, recording: Recording, survey: RecordingSurvey) -> Config:
    """Return the product's config for a recording.

    Its [safety] only bounds the map: nothing is flown.

    Raises UserError with exit code 78.
    """
    mount, lens = recording.info.body_from_depth, survey.depth_lens
    axis = mount.rotation() @ (0.0, 0.0, 1.0)
    pitch_deg = math.degrees(math.asin(max(-1.0, min(1.0, -float(axis[2])))))
    field_deg = [math.degrees(2 * math.atan(size / 2 / f)) for size, f in ((lens.width, lens.fx), (lens.height, lens.fy))]
    tree = {
        "safety": {
            **REFERENCE_SAFETY,
            "fence_min_m": survey.box_min_m.tolist(), "fence_max_m": survey.box_max_m.tolist(), "fence_inset_m": 0.25,
            "vehicle_radius_m": 0.15, "vehicle_height_m": 0.2, "blind_speed_mps": 0.3,
        },
        "camera": {
            "source": "recorded", "recording": str(options.source.absolute()), "mount": "fixed",
            "position_body_m": mount.translation_m.tolist(), "pitch_down_deg": max(-60.0, min(60.0, pitch_deg)),
            "horizontal_fov_deg": field_deg[0], "vertical_fov_deg": field_deg[1],
            "depth_min_m": options.read.depth_min_m, "depth_max_m": options.read.depth_max_m,
        },
        "localization": {"source": "stream" if options.pose == FROM_RECORDING else options.pose, "origin": "source"},
        "mission": {"views": options.views, "takeoff_height_m": 0.5},
        "recording": {"folder": str(options.out.absolute()), "rerun": False},
        "runtime": {"folder": str(options.out.absolute())},
    }  # fmt: skip
    try:
        return parse(tree, str(options.source))
    except ConfigError as error:
        raise UserError(str(error), EXIT_CONFIG) from None


def _mapper(name: str, config: Config, folder: Path) -> Mapper:
    if name == "none":
        return NoMapper()
    from uav_recon.mapping.keyframe_store import KeyframeFolder
    from uav_recon.mapping.neural.worker.inline_mapper import InlineMapper
    from uav_recon.mapping.neural.worker.mapper_process import KEYFRAMES

    trainer = mapper_factory.make_neural_mapper(config)
    trainer.warm_up()
    return InlineMapper(trainer, config.mapper, KeyframeFolder(folder / KEYFRAMES))


def _print(summary: ReplaySummary, options: ReplayOptions, console: Console) -> None:
    table = Table(title=f"{summary.source} ({summary.kind}, {summary.recorded_s:.1f} s)", show_header=False)
    refused = ", ".join(f"{reason} {count}" for reason, count in summary.refused.items()) or "none"
    alarms = ", ".join(f"{reason} {count}" for reason, count in summary.alarms.items()) or "none"
    for name, value in (
        ("frames: recorded, read, used", f"{summary.frames_in_recording}, {summary.frames_read}, {summary.frames_used}"),
        *(("not read: " + name, str(count)) for name, count in summary.skipped.items()),
        ("refused, by reason", refused), ("drift alarms", alarms), ("pose lost", f"{summary.lost_s:.1f} s"),
        ("path", f"{summary.path_length_m:.2f} m"), ("explored", f"{summary.explored_m3:.1f} m³"),
        ("views, plans", f"{summary.views}, {summary.plans}"),
        *((f"calibration: {name}", f"{value:.4f} ± {sigma:.4f}") for name, value, sigma in summary.calibration),
        ("computed in", f"{summary.wall_s:.1f} s"), ("results", str(options.out)),
    ):  # fmt: skip
        table.add_row(name, value)
    console.print(table)
