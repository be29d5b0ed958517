"""Client of the mapper process, which may die and be restarted.

The disk is the queue between the processes: a keyframe is first written to the flight folder, then its number is sent. So a
restarted child has all data it needs, and the mission never waits for the child.
"""

from __future__ import annotations

import logging
import queue
import shutil
import threading
import time
from collections import Counter
from pathlib import Path

from uav_recon.channels import ReadOnlyFileChannel
from uav_recon.clock import RateKeeper
from uav_recon.config import MapperConfig
from uav_recon.mapping.keyframe_store import KeyframeFolder
from uav_recon.mapping.neural.keyframes.keyframe_validation import (
    RejectCounts,
    RejectReason,
    counts_as_text,
    padded_box,
    reject_reason,
)
from uav_recon.mapping.neural.keyframes.normal_prior import open_prior
from uav_recon.mapping.neural.worker.child_watchdog import CHECK_PERIOD_S, ChildWatchdog, activity_of
from uav_recon.mapping.neural.worker.mapper_process import (
    CHECKPOINT,
    KEYFRAMES,
    LOG_FILE,
    SURFACE_BYTES,
    SURFACE_FILE,
    ChildProcess,
    Message,
)
from uav_recon.types.camera import PosedFrame
from uav_recon.types.frames import FloatArray
from uav_recon.types.maps import SurfaceElements
from uav_recon.types.pose import MapCorrection

LOG = logging.getLogger(__name__)

BACKLOG = 64  # maximum number of keyframes waiting to be saved
RESTARTS = 3
# finish() timeout: constant part, per polish step, per view
FINISH_S = 120.0
FINISH_STEP_S = 0.1
FINISH_VIEW_S = 2.0
END_S = 5.0


class ProcessMapper:
    """The mapper in a child process at low priority. Only finish() and close() block.

    The child ends when this process ends for any reason. When the child dies, a new one resumes from its checkpoint and
    learns the later keyframes, at most RESTARTS times. A child that hangs is killed.

    box_min_m, box_max_m (3,): the room. One thread owns the child and the disk; the methods only put messages into its
    queue. The constructor raises OSError if the folder cannot be written, PriorError if config.prior_model cannot be used.
    """

    def __init__(
        self,
        config: MapperConfig,
        box_min_m: FloatArray,
        box_max_m: FloatArray,
        depth_noise_px: float,
        baseline_m: float,
        folder: Path,
        *,
        own_poses: bool = False,
    ) -> None:
        open_prior(config.prior_model)  # raises here, where the caller can report it
        self._config = config
        self._folder = folder
        self._low, self._high = padded_box(box_min_m, box_max_m)
        self._order = {
            "config": config.model_dump(mode="json"),
            "box_min_m": [float(x) for x in box_min_m],
            "box_max_m": [float(x) for x in box_max_m],
            "depth_noise_px": depth_noise_px,
            "own_poses": own_poses,
            "baseline_m": baseline_m,
            "folder": str(folder),
        }
        self._keyframes = KeyframeFolder(folder / KEYFRAMES)
        self._channel = ReadOnlyFileChannel(folder / SURFACE_FILE, SurfaceElements, SURFACE_BYTES)
        self._notes: queue.Queue[PosedFrame | MapCorrection | Path | Message] = queue.Queue()
        self._epoch: int | None = None  # map epoch, once there is one
        self._ready = threading.Event()
        self._over = threading.Event()
        self._losses = 0
        self._finishing = False
        self._refusals = RejectCounts()
        self._childs_refusals = Counter[RejectReason]()
        self._mesh_folder: Path | None = None
        self._child = self._start()
        self._owner = threading.Thread(target=self._serve, name="mapper-owner", daemon=True)
        self._owner.start()

    @property
    def pid(self) -> int:
        """Process id of the current child."""
        return self._child.pid

    def add(self, keyframe: PosedFrame) -> bool:
        """Queue a view; returns False if it is rejected, the queue is full, or no restart is left.

        Returns True while a new child is starting: the view will be on disk and will be learned.
        """
        if self._finishing or self._gone() or self._notes.qsize() >= BACKLOG:
            return False
        reason = reject_reason(keyframe, self._low, self._high)
        if self._epoch not in (None, keyframe.map_epoch):
            reason = RejectReason.EPOCH
        if reason is not None:
            self._refusals.note(reason)
            return False
        self._epoch = keyframe.map_epoch
        self._notes.put(keyframe)
        return True

    def repose(self, correction: MapCorrection) -> None:
        """Move the views to their poses in a new map epoch and relearn the map from them.

        Views without a pose in the correction are counted as rejected. Returns at once. surface() returns None until the new
        map has been learned.
        """
        if not self._finishing:
            self._epoch = correction.map_epoch
            self._notes.put(correction)

    def refusals(self) -> Counter[RejectReason]:
        """Return the number of rejected views by reason, of add() and of the child."""
        return self._refusals.counts + self._childs_refusals

    def refused(self) -> dict[str, int]:
        """Return the number of rejected views by reason, as text."""
        return counts_as_text(self.refusals())

    def surface(self) -> SurfaceElements | None:
        """Return the newest surface of this map epoch, or None. Does not wait for the child.

        The surface may come from a child that has died since.
        """
        surface = self._channel.latest()
        return surface if surface is not None and self._epoch in (None, surface.map_epoch) else None

    def alive(self) -> bool:
        """Return True unless the child died and no successor has learned the saved keyframes yet."""
        return self._child.running() and not self._gone() and (self._losses == 0 or self._ready.is_set())

    def ready(self) -> bool:
        """Return True if the child has compiled its kernels and learned the keyframes on disk."""
        return self._ready.is_set() and self._child.running()

    def finish(self, folder: Path) -> None:
        """Polish, write mesh.ply into the folder and end the child.

        Blocks; the timeout grows with the polish steps and the views. If the child fails, there is no mesh.ply; an error is
        logged and the reason is in mapper.log.
        """
        self._finishing = True
        patience_s = FINISH_S + FINISH_STEP_S * self._config.polish_steps + FINISH_VIEW_S * len(self._keyframes)
        self._notes.put(folder)
        if not self._over.wait(patience_s):
            LOG.error("the mapper made no mesh within %.0f s; see %s", patience_s, self._folder / LOG_FILE)
        self.close()

    def close(self) -> None:
        """End the child at once without a mesh, and delete the files needed in flight only."""
        self._finishing = True
        self._notes.put({"event": "close"})
        self._owner.join()
        (self._folder / SURFACE_FILE).unlink(missing_ok=True)
        shutil.rmtree(self._folder / CHECKPOINT, ignore_errors=True)

    def _gone(self) -> bool:
        return self._losses > RESTARTS

    def _start(self) -> ChildProcess:
        self._ready.clear()
        self._watchdog = ChildWatchdog()
        return ChildProcess(self._order, self._folder / LOG_FILE, self._notes.put)

    def _serve(self) -> None:
        looks = RateKeeper(1.0 / CHECK_PERIOD_S, time.monotonic())
        while True:
            if looks.due(time.monotonic()):
                self._check_child()
            try:
                note = self._notes.get(timeout=max(0.0, looks.next_s() - time.monotonic()))
            except queue.Empty:
                continue
            if isinstance(note, PosedFrame):
                self._hand_over(note)
            elif isinstance(note, MapCorrection):
                self._hand_over_poses(note)
            elif isinstance(note, Path):
                self._mesh_folder = note
                self._child.send({"finish": str(note)})
            elif note["event"] == "close":
                self._child.end(END_S)
                return
            else:
                self._hear(note)

    def _check_child(self) -> None:
        now_s = time.monotonic()
        if not self._watchdog.answer_pending:
            self._child.send({"answer": True})
            self._watchdog.asked(now_s)
        elif self._watchdog.is_hung(now_s, activity_of(self._child.pid), patient=self._finishing or not self._ready.is_set()):
            LOG.error("the mapper hangs and is killed")
            self._watchdog.answered()
            self._child.kill()

    def _hear(self, message: Message) -> None:
        if message["event"] == "ready":
            self._ready.set()
        elif message["event"] == "answer":
            self._watchdog.answered()
        elif message["event"] == "finished":
            self._over.set()
        elif message["event"] == "refused":
            self._childs_refusals = Counter({RejectReason[name]: count for name, count in message["counts"].items()})
        else:
            self._replace_child()

    def _hand_over(self, keyframe: PosedFrame) -> None:
        try:
            number = self._keyframes.save(keyframe)
        except OSError as error:
            LOG.error("a keyframe was lost: %s", error)
            return
        self._child.send({"keyframe": number})

    def _hand_over_poses(self, correction: MapCorrection) -> None:
        try:
            self._keyframes.repose(correction)
        except OSError as error:
            LOG.error("the views keep their old places: %s", error)
            return
        self._child.send({"repose": correction.map_epoch})

    def _replace_child(self) -> None:
        self._losses += 1
        self._ready.clear()
        if self._gone():
            LOG.error("the mapper died %d times; see %s", self._losses, self._folder / LOG_FILE)
            self._over.set()
            return
        LOG.warning("the mapper died with %d keyframes; starting it again", len(self._keyframes))
        self._child.end(END_S)
        self._child = self._start()
        if self._mesh_folder is not None and not self._over.is_set():
            self._child.send({"finish": str(self._mesh_folder)})
