"""Simulator process, and construction of the simulator.

Run as `python -m sitl.apps.world_process OPTIONS.json`.
"""

from __future__ import annotations

import contextlib
import gc
import math
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sitl.autopilots.ardupilot.autopilot import ArduCopter
from sitl.autopilots.ardupilot.parameters import ArduPilotParameters
from sitl.autopilots.ardupilot.tuning import lean_lag_s
from sitl.autopilots.base_autopilot import Autopilot
from sitl.autopilots.byte_links import ByteEnd, UdpPeer
from sitl.autopilots.flow_parameters import flow_parameters, set_parameters
from sitl.autopilots.parameter_table import ParameterTable
from sitl.autopilots.px4.autopilot import Px4
from sitl.autopilots.px4.parameters import Px4Parameters
from sitl.camera import d435i
from sitl.camera.camera_errors import CameraErrors
from sitl.outside_world import Flyer, OutsideWorld, RenderThread
from sitl.real_firmware.ardupilot import ArduPilotBinary
from sitl.real_firmware.firmware_vehicle import FirmwareVehicle
from sitl.real_firmware.process import FirmwareError
from sitl.real_firmware.px4 import Px4Binary
from sitl.scene.mesh_simplification import simplified
from sitl.scene.rasterizer import Renderer
from sitl.scene.scene import Scene, load_scene
from sitl.truth.hull_clearance import HullClearance
from sitl.world.flow_sensor import SimulatedFlowModule
from sitl.world.onboard_tracker import OnboardTracker
from sitl.world.pose_tracker import SimulatedTracker
from sitl.world.quadrotor import AirframeDynamics, Quadrotor
from sitl.world.range_finder import SimulatedUpwardRangeFinder
from sitl.world.step_sizes import FINE_STEPS, StepSizes
from uav_recon import json_codec
from uav_recon.sensors.stream_format import StreamWriter

STEP_S = 0.004
_NO_FULL_GC = 10**9  # number of partial garbage collections before a full one


@dataclass(frozen=True)
class WorldOptions:
    """Options of the simulator, in the frame of the scene.

    start: x, y, z (m), yaw (degrees). fence: lower and upper corner (m).
    """

    scene: str | None
    start: tuple[float, float, float, float] | None
    fence: tuple[float, float, float, float, float, float] | None
    seed: int
    autopilot: str  # px4 or ardupilot
    mount_pitch_down_deg: float | None  # None = gimbal
    depth_noise: d435i.Noise
    camera: d435i.Model
    radius_m: float  # radius of the hull
    port: int
    stream: str
    truth: str
    firmware: str | None = None  # path of a real firmware, which flies in real time
    onboard_poses: bool = False  # the poses go to the autopilot in place of the stream
    range_up_deg: float | None = None  # angle of the cone of a range finder that looks up; None: there is none
    flow: bool = False  # an optical flow sensor and a range finder look down
    camera_errors: float = 0.0  # scale of the errors of the camera, which the seed draws; 0: the exact camera

    def save(self, path: Path) -> None:
        """Write as JSON."""
        path.write_text(json_codec.to_line(self), encoding="utf-8")

    @staticmethod
    def load(path: Path) -> WorldOptions:
        """Read the options from JSON."""
        return json_codec.from_text(WorldOptions, path.read_text(encoding="utf-8"))

    def drawn_camera_errors(self) -> CameraErrors:
        """Return the errors of this flight's camera."""
        return CameraErrors.drawn(self.seed, self.camera_errors, gimbal=self.mount_pitch_down_deg is None)

    def scene_of(self) -> Scene:
        """Load the scene. Raises SceneError."""
        return load_scene(self.scene, self.start, self.fence, self.radius_m)


def make_world(
    options: WorldOptions, scene: Scene, link: ByteEnd, now_s: Callable[[], float], pace: StepSizes = FINE_STEPS
) -> OutsideWorld:
    """Create the simulator with a simulated autopilot; its time starts after kernel compilation."""
    return _assemble(options, scene, lambda room: _autopilot(options, scene, room, link, pace), now_s, pace)


def make_firmware_world(
    firmware: Path, options: WorldOptions, scene: Scene, companion_port: int, ends: contextlib.ExitStack
) -> OutsideWorld:
    """Create the simulator with a real firmware, which sends to companion_port.

    `ends` ends the firmware. Raises FirmwareError.
    """

    def boot(_: HullClearance) -> Flyer:
        return ends.enter_context(contextlib.closing(_firmware(options, firmware, scene, companion_port)))

    return _assemble(options, scene, boot, time.monotonic, FINE_STEPS)


def _assemble(
    options: WorldOptions, scene: Scene, boot: Callable[[HullClearance], Flyer], now_s: Callable[[], float], pace: StepSizes
) -> OutsideWorld:
    """Compile the kernels, create the vehicle on its pad, then start the simulator's time."""
    renderer, clearance = _renderer(scene, options.camera), HullClearance(scene, options.radius_m)
    d435i.warm_up()
    clearance.hull_m(np.zeros(3))
    clearance.standing_m((0.0, 0.0, 0.0))
    errors = options.drawn_camera_errors()
    camera = d435i.SimulatedD435i(renderer, options.camera, options.depth_noise, options.seed, errors)
    flyer = boot(clearance)
    pitch_rad = None if options.mount_pitch_down_deg is None else math.radians(options.mount_pitch_down_deg)
    stream = StreamWriter(Path(options.stream), camera.header)
    tracker = SimulatedTracker(options.seed)
    if options.range_up_deg is not None and isinstance(flyer, Autopilot):
        flyer.mount_range_finder(SimulatedUpwardRangeFinder(scene, options.seed, math.radians(options.range_up_deg)))
    if options.flow and isinstance(flyer, (Autopilot, FirmwareVehicle)):
        flyer.mount_flow_module(SimulatedFlowModule(scene, options.seed))
    onboard = OnboardTracker(options.seed, flyer.fuse_own) if options.onboard_poses and isinstance(flyer, Autopilot) else None
    return OutsideWorld(flyer, camera, tracker, clearance, stream, now_s(), pitch_rad, pace, errors, onboard)


def _autopilot(options: WorldOptions, scene: Scene, room: HullClearance, link: ByteEnd, pace: StepSizes) -> Autopilot:
    """Return the simulated autopilot with the parameters from firmware_params/."""
    yaw_rad, standing_m = scene.start_yaw_rad, room.standing_m
    if options.autopilot == "ardupilot":
        parameters = ArduPilotParameters.load()
        set_flow_parameters(parameters, options)
        airframe = AirframeDynamics(tilt_lag_s=lean_lag_s(parameters))
        vehicle = Quadrotor(seed=options.seed, yaw_rad=yaw_rad, airframe=airframe, support_height_m=standing_m)
        return ArduCopter(vehicle, link, parameters, options.seed, pace.physics_s)
    vehicle = Quadrotor(seed=options.seed, yaw_rad=yaw_rad, support_height_m=standing_m)
    px4 = Px4Parameters.load()
    set_flow_parameters(px4, options)
    return Px4(vehicle, link, px4, options.seed, pace.physics_s)


def set_flow_parameters(table: ParameterTable, options: WorldOptions) -> None:
    """Set the parameters of the flow module, if the options have one, as its user does."""
    if options.flow:
        set_parameters(table, flow_parameters(options.autopilot))


def _renderer(scene: Scene, camera: d435i.Model) -> Renderer:
    if camera != "fast":
        seen = scene.paint or scene
        return Renderer(seen.vertices, seen.faces, seen.rgb)
    vertices, faces = simplified(scene.vertices, scene.faces)  # this camera has no colour
    return Renderer(vertices, faces, np.zeros(vertices.shape, np.uint8))


def binary_of(autopilot: str, firmware: Path, flow: bool = False) -> ArduPilotBinary | Px4Binary:
    """Return the firmware adapter for a binary. flow: a flow module is mounted."""
    return ArduPilotBinary(firmware, flow=flow) if autopilot == "ardupilot" else Px4Binary(firmware, flow=flow)


def _firmware(options: WorldOptions, firmware: Path, scene: Scene, companion_port: int) -> FirmwareVehicle:
    """Start a firmware, with its files beside the stream and its output in logs/.

    Raises FirmwareError.
    """
    binary = binary_of(options.autopilot, firmware, options.flow)
    folder, log = Path(options.stream).with_name("firmware"), Path(options.truth).parent / "logs" / "firmware.log"
    return FirmwareVehicle(binary, companion_port, scene.start_yaw_rad, folder, log)


def fly(options: WorldOptions) -> None:
    """Run in real time until SIGTERM, then write the truth. Raises FirmwareError."""
    stopping: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: stopping.append(number))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.ExitStack() as ends:
        world = _outside(options, options.scene_of(), ends)
        try:
            run(world, lambda _: bool(stopping))
        finally:
            world.truth_log.save(Path(options.truth), world)


def _outside(options: WorldOptions, scene: Scene, ends: contextlib.ExitStack) -> OutsideWorld:
    """Return the simulator with autopilot or firmware; `ends` closes its link or its firmware."""
    if options.firmware is not None:
        return make_firmware_world(Path(options.firmware), options, scene, options.port, ends)
    link = ends.enter_context(contextlib.closing(UdpPeer(remote=("127.0.0.1", options.port))))
    return make_world(options, scene, link, time.monotonic)


def run(world: OutsideWorld, ended: Callable[[float], bool]) -> None:
    """Step the simulator in real time until ended(now_s), called before each step, is True.

    Full garbage collections are disabled in the whole process: after 76 minutes of flight one of them stopped the
    simulator for 0.57 s.
    """
    gc.freeze()
    gc.set_threshold(*gc.get_threshold()[:2], _NO_FULL_GC)
    darkroom = RenderThread(world)
    next_s = time.monotonic()
    while not ended(now_s := time.monotonic()):
        world.step(now_s)
        if world.frame_due(now_s):
            darkroom.submit(world.begin_frame())
        next_s = max(next_s + STEP_S, now_s)
        time.sleep(max(next_s - time.monotonic(), 0.0))
    darkroom.close()


if __name__ == "__main__":
    sys.setswitchinterval(0.001)
    try:
        fly(WorldOptions.load(Path(sys.argv[1])))
    except FirmwareError as error:
        sys.exit(str(error))
