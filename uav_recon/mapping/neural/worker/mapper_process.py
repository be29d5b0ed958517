"""The mapper process and the parent's handle on it; they exchange JSON lines through pipes.

Run as ``python -m uav_recon.mapping.neural.worker.mapper_process``. The first line holds the start parameters (config, box,
noise, folder). Requests: {"keyframe": N} for each view on disk; {"repose": EPOCH} when the views on disk have new poses, of
a new map epoch; {"answer": true} to check that the child responds; {"finish": FOLDER} at the end. Replies: {"event": "ready"
| "answer" | "finished"} and, when views were rejected, {"event": "refused", "counts": {REASON: total count}}.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np

from uav_recon.channels import FileChannel
from uav_recon.config import MapperConfig
from uav_recon.mapping.keyframe_store import KeyframeError, KeyframeFolder
from uav_recon.mapping.neural.keyframes.keyframe_validation import RejectReason
from uav_recon.mapping.neural.neural_mapper import NeuralMapper
from uav_recon.mapping.neural.worker.checkpoint import CheckpointError, MapperCheckpoints
from uav_recon.mapping.neural.worker.final_model import write_final_model
from uav_recon.types.maps import SurfaceElements

LOG = logging.getLogger(__name__)

CHECKPOINT = ".mapper_checkpoint"
KEYFRAMES = "keyframes"
SURFACE_FILE = ".mapper_surface"
LOG_FILE = "mapper.log"
SURFACE_BYTES = 48 << 20  # a sparse file: a room of 30 m² needs 3 MB
NICENESS = 10
OOM_SCORE_ADJ = 1000
IDLE_SURFACE_STEPS = 60  # idle steps between two surfaces

Message = dict[str, Any]


class ChildProcess:
    """One child process.

    The child ends when its pipe closes, so also when this process ends for any reason.
    """

    def __init__(self, order: Message, log: Path, tell: Callable[[Message], None]) -> None:
        """Start the child.

        tell() is called from a thread of this object with each message of the child, and with {"event": "lost"} at the end.
        """
        environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
        with log.open("ab") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "uav_recon.mapping.neural.worker.mapper_process"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                env=environment,
                start_new_session=True,  # keep a terminal's Ctrl-C from the mapper
            )
        self._tell = tell
        self._listener = threading.Thread(target=self._listen, name="mapper-events", daemon=True)
        self._listener.start()
        self.send(order)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def running(self) -> bool:
        """Return True if the process is running."""
        return self._process.poll() is None

    def send(self, message: Message) -> None:
        """Write a line. A dead child is not reported here but through tell()."""
        pipe = self._process.stdin
        if pipe is None or pipe.closed:
            return
        try:
            pipe.write(json.dumps(message).encode() + b"\n")
            pipe.flush()
        except (BrokenPipeError, OSError):
            return

    def kill(self) -> None:
        """Kill the child; tell() receives {"event": "lost"}."""
        self._process.kill()

    def end(self, patience_s: float) -> None:
        """Close the pipe, wait, and kill the child after a timeout."""
        try:
            if self._process.stdin is not None:
                self._process.stdin.close()
        except OSError:
            pass  # unsent bytes for a dead child
        try:
            self._process.wait(patience_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._listener.join()

    def _listen(self) -> None:
        pipe = self._process.stdout
        if pipe is not None:
            with pipe:
                for line in pipe:
                    self._tell(json.loads(line))
        self._process.wait()
        self._tell({"event": "lost"})


def main() -> None:
    """Serve one parent until its pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _lower_priority()
    replies = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)  # a stray print must not break the protocol
    logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s")
    messages: queue.Queue[Message] = queue.Queue()
    order: Message = json.loads(sys.stdin.buffer.readline())
    asked = threading.Event()
    threading.Thread(target=_read, args=(sys.stdin.buffer, messages, asked), daemon=True).start()
    _Session(order, messages, replies, asked).run()


def _lower_priority() -> None:
    """Lower the processor priority and make this process the first to kill if memory is short.

    The autogroup value is needed where the kernel schedules sessions instead of processes: sched(7). Without oom_score_adj
    the kernel would kill the mission, the parent: it is larger, and the flight needs it.
    """
    os.nice(NICENESS)
    for name, value in (("autogroup", NICENESS), ("oom_score_adj", OOM_SCORE_ADJ)):
        with contextlib.suppress(OSError):  # not supported by this kernel
            Path("/proc/self", name).write_text(str(value), encoding="ascii")


def _read(pipe: IO[bytes], messages: queue.Queue[Message], asked: threading.Event) -> None:
    for line in pipe:
        message = json.loads(line)
        if "answer" in message:
            asked.set()  # answered before earlier messages, because many views may wait
        messages.put(message)
    os._exit(0)  # the parent is gone or wants this process to end: exit at once, even in the middle of a kernel


class _Session:
    def __init__(
        self, order: Message, messages: queue.Queue[Message], replies: IO[bytes], asked: threading.Event
    ) -> None:  # fmt: skip
        self._config = MapperConfig.model_validate(order["config"])
        self._messages = messages
        self._replies = replies
        self._asked = asked
        folder = Path(order["folder"])
        self._keyframes = KeyframeFolder(folder / KEYFRAMES)
        self._channel = FileChannel(folder / SURFACE_FILE, SurfaceElements, SURFACE_BYTES)
        low, high = np.array(order["box_min_m"]), np.array(order["box_max_m"])
        camera = order["depth_noise_px"], order["baseline_m"]
        self._trainer = NeuralMapper(self._config, low, high, *camera, own_poses=order["own_poses"])
        self._checkpoints = MapperCheckpoints(
            folder / CHECKPOINT, {name: value for name, value in order.items() if name != "folder"}
        )
        self._revision = self._channel.sequence()
        # keyframes learned; True while the published surface lacks some
        self._learned = 0
        self._unseen = False
        self._refused = 0  # total count last reported to the parent

    def run(self) -> None:
        self._trainer.warm_up()
        self._restore()
        self._look_on_disk()
        self._learn_to(len(self._keyframes))
        self._send_reject_counts()
        self._show()
        self._say("ready")
        idle_s = 1.0 / self._config.idle_steps_hz if self._config.idle_steps_hz > 0 else None
        idle_steps = 0
        while True:
            try:
                patience_s = 0.0 if self._trainer.waiting else idle_s
                message = self._messages.get(timeout=patience_s if self._trainer.views else None)
            except queue.Empty:
                if self._trainer.waiting:
                    self._unseen |= self._trainer.learn_waiting(1) == 0
                    self._send_reject_counts()
                    self._show()
                    continue
                self._trainer.train(1)
                self._save()
                idle_steps += 1
                if idle_steps % IDLE_SURFACE_STEPS == 0:
                    self._publish()
                continue
            if "answer" in message:
                self._answer()
                self._show()
            elif "finish" in message:
                self._finish(Path(message["finish"]))
            elif "repose" in message:
                self._look_on_disk()
                self._send_reject_counts()
            else:
                self._learn_to(int(message["keyframe"]) + 1)
                self._show()

    def _show(self) -> None:
        """Publish the surface if it has news, no request waits and the map is complete."""
        if self._unseen and not self._trainer.waiting and not self._behind():
            self._publish()

    def _behind(self) -> bool:
        """Return True if a request other than "answer" waits."""
        with self._messages.mutex:
            return any("answer" not in message for message in self._messages.queue)

    def _learn_to(self, count: int) -> None:
        """Learn the keyframes up to a count; does nothing for those already learned."""
        if count <= self._learned:
            return
        self._look_on_disk()
        for number in range(self._learned, min(count, len(self._keyframes))):
            self._answer()
            try:
                if self._keyframes.pose(number) is None:
                    self._trainer.refusals.note(RejectReason.UNPLACED)
                elif self._trainer.add(self._keyframes.load(number), number):
                    self._trainer.train(self._config.steps_per_view)
            except KeyframeError as error:
                LOG.warning("%s", error)  # skip this view
            self._learned = number + 1
            self._save()
        self._unseen = True
        self._send_reject_counts()

    def _look_on_disk(self) -> None:
        """Read what the parent wrote; if the views moved to a new map epoch, start the new map."""
        self._keyframes.refresh()
        epoch = self._keyframes.map_epoch
        if epoch == self._trainer.map_epoch or not self._trainer.kept:
            return
        poses = {number: self._keyframes.pose(number) for number in self._trainer.kept}
        self._trainer.repose({number: pose for number, pose in poses.items() if pose is not None}, epoch)
        LOG.warning("map epoch %d: %d views have a place in it", epoch, self._trainer.waiting)

    def _restore(self) -> None:
        """Resume from a valid checkpoint, if there is one. Later keyframes are learned from disk."""
        try:
            found = self._checkpoints.load(self._keyframes)
        except CheckpointError as error:
            LOG.warning("%s; learning all %d keyframes again", error, len(self._keyframes))
            return
        if found is not None:
            self._trainer, self._learned = found
            self._unseen = True
            LOG.warning("went on from a checkpoint with %d of %d keyframes", self._learned, len(self._keyframes))

    def _save(self) -> None:
        self._checkpoints.save_if_due(self._trainer, self._learned, self._keyframes.stamp_s(self._learned - 1))

    def _send_reject_counts(self) -> None:
        refusals = self._trainer.refusals
        if refusals.total() != self._refused:
            self._refused = refusals.total()
            self._say("refused", counts={reason.name: count for reason, count in refusals.counts.items()})

    def _publish(self) -> None:
        self._unseen = False
        self._revision += 1
        surface = self._trainer.surface()
        for every in (1, 2, 4, 8, 16):
            try:
                self._channel.publish(
                    SurfaceElements(
                        surface.position_world[::every],
                        surface.normal_world[::every],
                        surface.uncertainty[::every],
                        self._revision,
                        surface.map_epoch,
                    )
                )
                return
            except ValueError:  # very large room: a subset of the elements suffices
                continue

    def _finish(self, folder: Path) -> None:
        write_final_model(folder, self._trainer, self._config)
        self._say("finished")

    def _answer(self) -> None:
        """Send an answer if one was requested."""
        if self._asked.is_set():
            self._asked.clear()
            self._say("answer")

    def _say(self, event: str, **more: object) -> None:
        self._replies.write(json.dumps({"event": event} | more).encode() + b"\n")


if __name__ == "__main__":
    main()
