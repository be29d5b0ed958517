"""Loops of the processes: built by the factories, run at a rate, ended in order."""

from __future__ import annotations

import fcntl
import logging
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

import numpy as np

from uav_recon import config as configuration
from uav_recon.app import (
    config_file,
    kernel_jobs,
    memory_lock,
    mission_factory,
    operator_factory,
    perception_factory,
    pilot_factory,
    process_table,
    recorder_factory,
    systemd_notify,
)
from uav_recon.app.flight_channels import (
    MISSION_WRITES,
    PERCEPTION_WRITES,
    PILOT_WRITES,
    file_channels,
    made_writable,
    read_only_channels,
)
from uav_recon.app.kernel_cache import compile_kernels, log_progress
from uav_recon.app.option_validation import UsageError, readable
from uav_recon.app.wait_notice import WaitNotice, missing_processes
from uav_recon.clock import MonotonicClock, RateKeeper, ThreadExecutor
from uav_recon.config import Config
from uav_recon.errors import EXIT_CONFIG, EXIT_SECOND_COPY, UserError
from uav_recon.interfaces import Channel, Clock
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import FlightPhase, VehicleState

if TYPE_CHECKING:
    from uav_recon.mapping.neural.worker.mapper_client import ProcessMapper
    from uav_recon.recording.report import Report

LOG = logging.getLogger(__name__)

PERCEPTION_RATE_HZ = 100.0
PILOT_SILENT_S = 1.0  # a VehicleState older than this counts as no pilot; longer than one lost turn
MISSION_RATE_HZ = 30.0
WRITER_PATIENCE_S = 1.0  # how long perception waits, as it ends, for the file of the camera's errors
PLANNER_PATIENCE_S = 2.0  # how long a process that ends waits for a running planner call
RECORDER_RATE_HZ = 10.0


class Stop:
    """Records SIGTERM and SIGINT; the loop decides what they mean."""

    def __init__(self) -> None:
        self.asked = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._ask)

    def restore_default(self) -> None:
        """Restore the default: from now on both end the process."""
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        self.asked = True


def flight_folder(config: Config, flight: Path | None) -> Path:
    """Return the folder of this flight, created if needed.

    Raises UserError if it cannot be created.
    """
    folder = flight or config.recording.folder / time.strftime("%Y%m%d-%H%M%S")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"flight folder {folder}: cannot be written ({error.strerror})") from None
    return folder


def claim(name: str, config: Config) -> None:
    """Become the only process of this name on this machine, until it ends.

    Creates the runtime folder. Call it before the channels are opened: their writer is the only one. Raises UserError with exit
    code 75 if there is another one, with 78 if the folder cannot be written.
    """
    folder = config.runtime.folder
    with made_writable(folder):
        claim_file(folder / f"{name}.lock", f"another {name} process already runs in {folder}")


def claim_file(path: Path, otherwise: str) -> int:
    """Hold a lock file until this process ends, or closes the returned descriptor.

    Raises UserError with exit code 75 and the text ``otherwise`` if another process holds it, with 78 if it cannot be opened.
    """
    try:
        lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise UserError(f"{path}: cannot be opened ({error.strerror})", EXIT_CONFIG) from None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        raise UserError(otherwise, EXIT_SECOND_COPY) from None
    return lock


def pilot(config_path: Path, flight: Path | None) -> int:
    """Fly next to the autopilot until SIGTERM; in flight SIGTERM means: land, then end."""
    from uav_recon.autopilot.mavlink.tlog import Tlog
    from uav_recon.autopilot.mavlink.transport import LinkError, open_link

    stop, clock, config = Stop(), MonotonicClock(), config_file.load_config(config_path)
    claim("pilot", config)
    channels = file_channels(config.runtime.folder, PILOT_WRITES)
    allow_list = pilot_factory.make_allow_list_filter(config.link, clock)
    try:
        link = open_link(config.link.url, allow_list, clock, config.link.peer_host)
    except LinkError as error:
        raise UserError(str(error)) from None
    log = Tlog(flight_folder(config, flight) / "flight.tlog", time.time() - clock.now_s())
    the_pilot = pilot_factory.make_pilot(config, channels, link, log, clock, allow_list)
    command_socket = operator_factory.make_command_socket(config, channels, the_pilot, clock)
    memory_lock.lock_memory_and_freeze_gc()
    systemd_notify.ready()
    while not (stop.asked and not the_pilot.in_flight and phase_published(the_pilot.phase, channels.vehicle)):
        if stop.asked:
            the_pilot.operator.request_land()
        command_socket.poll()
        the_pilot.step()
        systemd_notify.watchdog()
        the_pilot.wait()
    command_socket.close()
    log.close()
    if log.gaps:
        LOG.warning("%s", log.gaps)
    link.close()
    allow_list.close()
    return 0


def phase_published(phase: FlightPhase, vehicle: Channel[VehicleState]) -> bool:
    """Return True if this phase was published.

    The mission writes no report before it receives LANDED.
    """
    state = vehicle.latest()
    return state is not None and state.phase is phase


def perception(config_path: Path) -> int:
    """Turn camera and poses into odometry and posed frames until SIGTERM.

    It also ends when the camera is gone, with a UserError.
    """
    stop, clock, config = Stop(), MonotonicClock(), config_file.load_config(config_path)
    claim("perception", config)
    channels = file_channels(config.runtime.folder, PERCEPTION_WRITES)

    def compile_ahead() -> None:
        compile_kernels(kernel_jobs.perception_jobs(), config_path, log_progress(LOG), lambda: stop.asked)

    writer = ThreadExecutor("kept-files", WRITER_PATIENCE_S)
    the_perception = perception_factory.make_perception(config, channels, clock, lambda: stop.asked, compile_ahead, writer)
    systemd_notify.ready()
    gone = run_perception(the_perception.step, channels.vehicle, clock, lambda: stop.asked)
    the_perception.close()
    if gone and not stop.asked:
        raise UserError(gone)
    return 0


def run_perception(step: Callable[[], None], vehicle: Channel[VehicleState], clock: Clock, asked: Callable[[], bool]) -> str:
    """Step until asked to end or until the camera is gone.

    Returns why the camera is gone, '' for nothing.

    Neither ends it while a vehicle flies by its poses: one that has to land without them drifts.
    """
    from uav_recon.sensors.realsense import RealSenseError

    rate, gone, said = RateKeeper(PERCEPTION_RATE_HZ, clock.now_s()), "", ""
    while not (why := "asked to end" if asked() else gone) or is_flown(vehicle, clock.now_s()):
        if why and not said:
            LOG.warning("%s: perception ends after the landing; the vehicle flies by its poses", why)
        said = why
        if asked():
            systemd_notify.extend(process_table.PERCEPTION.watchdog_s)  # each step, while it may not end
        try:
            step()
            gone = ""
        except RealSenseError as error:
            gone = gone or str(error)
        systemd_notify.watchdog()
        rate.due(clock.now_s())
        clock.sleep_until(rate.next_s())
    return gone


def is_flown(vehicle: Channel[VehicleState], now_s: float) -> bool:
    """Return True if the motors run, by us or by a human, as reported by a running pilot."""
    state = vehicle.latest()
    return state is not None and state.armed and abs(now_s - state.stamp_s) <= PILOT_SILENT_S


def mission(config_path: Path, flight: Path | None) -> int:
    """Fly one mission and write its folder; SIGTERM lands.

    Returns exit code 0 for any end of the flight.
    """
    from uav_recon.mission.requests.operator_commands import OperatorCommandReceiver
    from uav_recon.recording.flight_log import FlightLog, outcome_text
    from uav_recon.recording.map_file import save_map

    stop, clock, config = Stop(), MonotonicClock(), config_file.load_config(config_path)
    claim("mission", config)
    channels, begun_s = file_channels(config.runtime.folder, MISSION_WRITES), clock.now_s()
    orders = OperatorCommandReceiver(operator_factory.operator_command_receiver(config.runtime.folder), begun_s)
    folder = flight_folder(config, flight)
    configuration.save(config, folder / "config.toml")
    compile_kernels(kernel_jobs.mission_jobs(config.planner.variant), config_path, log_progress(LOG), lambda: stop.asked)
    mapper = _start_mapper(config, folder)
    recorder = _start_recorder(config_path, folder)
    journal, executor = FlightLog(folder), ThreadExecutor("planner", PLANNER_PATIENCE_S)
    try:
        mission_factory.warm_up(config)
        conductor = mission_factory.make_conductor(config, channels, mapper, executor, journal, time.perf_counter)
        systemd_notify.ready()
        waiting = WaitNotice("mission", clock.now_s())

        def step() -> None:
            waiting.update(clock.now_s(), missing_processes(channels, clock.now_s()))
            if stop.asked:
                conductor.requests.abort(Reason(ReasonCode.OPERATOR_LAND))
            orders.pass_on(conductor.requests, mapper.ready(), config.mission.autostart)
            conductor.step(clock.now_s())

        _loop(step, MISSION_RATE_HZ, clock, lambda: conductor.finished)
        aborted = conductor.close(clock.now_s())
        if conductor.map is not None:
            save_map(folder, conductor.map)
    finally:
        executor.close()
        systemd_notify.stopping()
        mapper.finish(folder)
        journal.refused_views(clock.now_s(), mapper.refused())
        journal.close()
        _stop_recorder(recorder)
    report = _write_report(config, folder, clock.now_s() - begun_s)
    LOG.info("%s", ": ".join(filter(None, (outcome_text(aborted), report.stop_reason))))
    return 0


def recorder(config_path: Path, flight: Path | None) -> int:
    """Subscribe to the channels, read-only, and record them until SIGTERM."""
    stop, clock, config = Stop(), MonotonicClock(), config_file.load_config(config_path)
    channels = read_only_channels(config.runtime.folder)
    the_recorder = recorder_factory.make_recorder(config, channels, flight_folder(config, flight), clock)
    waiting = WaitNotice("recorder", clock.now_s())

    def step() -> None:
        waiting.update(clock.now_s(), missing_processes(channels, clock.now_s()))
        the_recorder.step()

    _loop(step, RECORDER_RATE_HZ, clock, lambda: stop.asked or _hung_up(sys.stdin.fileno()))
    the_recorder.close()
    return 0


def review(flight: Path) -> int:
    """Open a flight in the viewer.

    Raises UserError, with exit code 2 if there is nothing to show.
    """
    from uav_recon.recording.review import ReviewError, recording_path
    from uav_recon.recording.review import review as open_review

    try:
        with readable(str(flight)):
            recording_path(flight)
    except ReviewError as error:
        raise UsageError(str(error)) from None
    try:
        open_review(flight)
    except ReviewError as error:
        raise UserError(str(error)) from None
    return 0


def _loop(step: Callable[[], None], rate_hz: float, clock: MonotonicClock, done: Callable[[], bool]) -> None:
    rate = RateKeeper(rate_hz, clock.now_s())
    while not done():
        step()
        systemd_notify.watchdog()
        rate.due(clock.now_s())
        clock.sleep_until(rate.next_s())


def _start_mapper(config: Config, folder: Path) -> ProcessMapper:
    """Start the mapper's process.

    Raises UserError with exit code 78 if the normal prior cannot be used.
    """
    from uav_recon.mapping.neural.keyframes.normal_prior import PriorError
    from uav_recon.mapping.neural.worker.mapper_client import ProcessMapper

    safety, camera = config.safety, config.camera
    low, high = np.array(safety.fence_min_m), np.array(safety.fence_max_m)
    try:
        own_poses = config.localization.source == "slam"
        return ProcessMapper(config.mapper, low, high, camera.depth_noise_px, camera.baseline_m, folder, own_poses=own_poses)
    except PriorError as error:
        raise UserError(str(error), EXIT_CONFIG) from None


def _write_report(config: Config, folder: Path, wall_s: float) -> Report:
    from uav_recon.app.unseen_space import with_unseen
    from uav_recon.recording.flight_report import FlightInfo, build_report, publish

    mount = "gimbal" if config.camera.mount == "gimbal" else f"fixed:{config.camera.pitch_down_deg:g}"
    card = FlightInfo(folder.name, config.planner.variant, config.link.autopilot, mount)
    report = with_unseen(build_report(folder, card, wall_s), config, folder)
    publish(report, folder)
    return report


def _start_recorder(config_path: Path, folder: Path) -> subprocess.Popen[bytes]:
    lowered = ["nice", "-n", str(process_table.RECORDER.niceness)]
    command = [*lowered, sys.executable, "-m", "uav_recon", *process_table.RECORDER.arguments(config_path, folder)]
    return subprocess.Popen(command, stdin=subprocess.PIPE)  # noqa: S603 - our own program


def _hung_up(pipe: int) -> bool:
    """Return True if the other end of a pipe is closed: the process that started us is gone.

    Always False for a terminal or /dev/null.
    """
    poll = select.poll()
    poll.register(pipe, 0)  # a hang-up is reported in any case
    return bool(poll.poll(0))


def _stop_recorder(recorder: subprocess.Popen[bytes]) -> None:
    recorder.terminate()
    try:
        recorder.wait(process_table.RECORDER.stop_timeout_s)
    except subprocess.TimeoutExpired:
        recorder.kill()
        recorder.wait()
