"""Builds the outside world, and is its process: `python -m sitl.fly_world OPTIONS.json`."""

from __future__ import annotations

import dataclasses
import json
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from sitl.clearance import Clearance
from sitl.d435i import Camera
from sitl.parameters import Parameters
from sitl.poses import NoisyPoses
from sitl.px4 import Px4
from sitl.raster import Renderer
from sitl.scene import Scene, load_scene
from sitl.transport import ByteEnd, UdpPeer
from sitl.vehicle import Quadrotor
from sitl.world import Darkroom, World
from uav_recon.sensors.wire import StreamWriter

CAMERA_RATE_HZ = 10.0
STEP_S = 0.004
PARAMETER_FILE = Path(__file__).parents[1] / "firmware_params" / "px4_indoor.params"


@dataclass(frozen=True)
class WorldOptions:
    """What the outside world is made of. start: x, y, z, yaw in degrees; fence: lower and upper corner; scene frame."""

    scene: str | None
    start: tuple[float, float, float, float] | None
    fence: tuple[float, float, float, float, float, float] | None
    seed: int
    mount_pitch_down_deg: float | None  # None = gimbal
    depth_noise: str
    camera: str
    port: int
    stream: str
    truth: str

    def save(self, path: Path) -> None:
        """Write as JSON."""
        path.write_text(json.dumps(dataclasses.asdict(self)), encoding="utf-8")

    @staticmethod
    def load(path: Path) -> WorldOptions:
        """Read what save() wrote."""
        return WorldOptions(**json.loads(path.read_text(encoding="utf-8")))

    def scene_of(self) -> Scene:
        """Load the scene. Raises SceneError."""
        return load_scene(self.scene, self.start, self.fence)


def make_world(options: WorldOptions, scene: Scene, link: ByteEnd, start_s: float) -> World:
    """Put the world together; compiles its kernels."""
    vehicle = Quadrotor(seed=options.seed, yaw_rad=scene.start_yaw_rad)
    autopilot = Px4(vehicle, link, Parameters.load(PARAMETER_FILE), seed=options.seed)
    camera = Camera(Renderer(scene.vertices, scene.faces, scene.rgb), options.camera, options.depth_noise, seed=options.seed)
    stream = StreamWriter(Path(options.stream), camera.header)
    world = World(autopilot, camera, NoisyPoses(options.seed), Clearance(scene), stream, CAMERA_RATE_HZ, start_s)
    if options.mount_pitch_down_deg is not None:
        world.fix_mount(options.mount_pitch_down_deg)
    return world


def fly(options: WorldOptions) -> None:
    """Run in real time until SIGTERM, then write the truth."""
    stopping: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: stopping.append(number))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    scene = options.scene_of()
    link = UdpPeer(remote=("127.0.0.1", options.port))
    world = make_world(options, scene, link, time.monotonic())
    world.develop(world.expose(time.monotonic()))  # compiles the renderer before time runs
    world.restart(time.monotonic())
    darkroom = Darkroom(world)
    next_s = time.monotonic()
    while not stopping:
        now_s = time.monotonic()
        world.step(now_s)
        if world.frame_due(now_s):
            darkroom.submit(world.expose(now_s))
        next_s = max(next_s + STEP_S, now_s)
        time.sleep(max(next_s - time.monotonic(), 0.0))
    darkroom.close()
    world.truth_log.save(Path(options.truth), world)
    link.close()


if __name__ == "__main__":
    sys.setswitchinterval(0.001)
    fly(WorldOptions.load(Path(sys.argv[1])))
