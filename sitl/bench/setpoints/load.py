"""Load generator: `python -m sitl.bench.setpoints.load CONFIG FOLDER [pilot]`.

One process with the load of the mission and mapper processes: the neural field trains, four threads run plain Python
without pause, a file is written and flushed to disk, and frames are published for the recorder. With the word ``pilot`` the
pilot's loop also runs in this process, as one of its threads. Runs until it is killed.
"""

from __future__ import annotations

import itertools
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from sitl.bench.mapper import seeded_views, training_run
from uav_recon import config as configuration
from uav_recon.app import processes
from uav_recon.app.flight_channels import file_channels
from uav_recon.interfaces import Channel
from uav_recon.types.camera import PosedFrame

LEARNING = "learning"  # a file of this name shows that the whole load is running
BUSY_THREADS = 4
VIEWS = 8
STEPS_PER_VIEW = 20
# 4 MiB blocks, and their number in one file
_BLOCK = os.urandom(1 << 22)
_BLOCKS = 16
_FRAMES_S = 0.1


def load_machine(config_path: Path, folder: Path, with_pilot: bool) -> None:
    """Start all loads; then run the pilot, or wait."""
    options = seeded_views.SceneOptions(None, VIEWS, "d435i", "d435i", "fixed:15", (0.0, 0.0), 0)
    scene = seeded_views.load(options)
    training_run.warm_up(scene.keyframes[0])
    channels = file_channels(configuration.load(config_path).runtime.folder, frozenset({"frames"}))
    _beside(_learn, scene, folder)
    _beside(_write, folder)
    _beside(_publish, scene.keyframes, channels.frames)
    for _ in range(BUSY_THREADS):
        _beside(_be_busy)
    if with_pilot:
        processes.pilot(config_path, folder / "flight")
    signal.pause()


def _learn(scene: seeded_views.MapperScene, folder: Path) -> None:
    trainer = training_run.make_trainer(scene, STEPS_PER_VIEW, seed=0)
    for view in itertools.chain(scene.keyframes, itertools.repeat(None)):
        if view is not None:
            trainer.add(view)
        trainer.train(STEPS_PER_VIEW)
        trainer.surface()
        (folder / LEARNING).touch()


def _write(folder: Path) -> None:
    while True:
        with (folder / "disk").open("wb") as file:
            for _ in range(_BLOCKS):
                file.write(_BLOCK)
                file.flush()
                os.fsync(file.fileno())


def _publish(views: Sequence[PosedFrame], frames: Channel[PosedFrame]) -> None:
    for view in itertools.cycle(views):
        frames.publish(view)
        time.sleep(_FRAMES_S)


def _be_busy() -> None:
    for number in itertools.count():
        sum(k * number for k in range(1000))


def _beside(work: Callable[..., None], *arguments: object) -> None:
    threading.Thread(target=work, args=arguments, name=work.__name__.strip("_"), daemon=True).start()


if __name__ == "__main__":
    load_machine(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:] == ["pilot"])
