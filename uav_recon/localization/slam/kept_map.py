"""Kept map: the map that one flight leaves to the next, and where this flight began in it.

A flight looks for what the one before has seen, until views from different directions agree on where it began. It writes its
own map once the vehicle rests after a flight. A flight whose odometry was found wrong writes nothing; a file of something else
is never replaced.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from uav_recon import atomic_file
from uav_recon.interfaces import Executor, Pending
from uav_recon.localization.slam.flown_map import FlownMap, ForeignMapError, copied, file_of
from uav_recon.localization.slam.keyframe_map import KeyframeMap
from uav_recon.localization.slam.prepared_view import PreparedView
from uav_recon.types.camera import Frame
from uav_recon.types.frames import AnyArray, FloatArray
from uav_recon.types.pose import Pose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_LOOK_EVERY_S = 0.3  # between views that are looked at: 20 ms each
_SOON_S = 60.0  # after which a flight that was not found is rather elsewhere, and looks ...
_RARELY_EVERY_S = 2.0  # ... after this time only
_SAME_M = 0.15  #: reject: places of one view by two transforms differ by more: they are not the same
_SAME_RAD = math.radians(3.0)  #: reject: the same of their turns
_AGREEING = 3  #: reject: fewer views that agree prove nothing
_AGREEING_SHARE = 0.75  #: reject: nor does a smaller share of all views that were placed
_APART_M = 0.3  #: reject: nor do views that are all nearer to each other than this ...
_APART_RAD = math.radians(15.0)  #: reject: ... and look in the same direction
_FEWEST_KEYFRAMES = 10  # a flight with fewer leaves no map
_WRITE_COST_S = 0.01  # declared cost of a write on a simulated clock
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class _PlacedView:
    """A view that was found in the earlier map. odom_from_depth and earlier_from_odom."""

    odom_from_depth: Pose
    earlier_from_odom: Pose

    def agrees(self, other: _PlacedView) -> bool:
        """Return True if another view says the same."""
        there = other.earlier_from_odom
        off_m = (self.earlier_from_odom.apply(self.eye_m) - there.apply(self.eye_m)).tolist()
        turned = (self.earlier_from_odom.inverse() @ there).rotation_vector()
        return math.hypot(*off_m) < _SAME_M and float(np.linalg.norm(turned)) < _SAME_RAD

    def is_apart(self, other: _PlacedView) -> bool:
        """Return True if another view is from elsewhere or in another direction."""
        moved = self.odom_from_depth.inverse() @ other.odom_from_depth
        return bool(np.linalg.norm(moved.translation_m) > _APART_M or np.linalg.norm(moved.rotation_vector()) > _APART_RAD)

    @property
    def eye_m(self) -> FloatArray:
        """Place (3,) of the depth imager in odom."""
        return self.odom_from_depth.translation_m


class KeptMap:
    """The file of a map. Not thread-safe.

    Reads it at once, which takes up to a second; writes beside the control loop.
    file: read by the next flight. surfaces: returns the tracker's map of this flight. executor: runs the writes.
    ``earlier_from_odom``: upright pose of this flight's odom in that of the earlier flight; None until it is found.
    ``reason``: None without a file, or whether this flight was found in it, or why the file is not used.
    """

    def __init__(self, file: Path, surfaces: Callable[[], KeyframeMap], executor: Executor) -> None:
        self._file = file
        self._surfaces = surfaces
        self._executor = executor
        self._earlier: FlownMap | None = None
        self._began_s, self._looked_s = math.inf, -math.inf
        self._placed: list[_PlacedView] = []
        self._pending: Pending[None] | None = None
        self._moved = self._wrong = self._foreign = False
        self.earlier_from_odom: Pose | None = None
        self.reason: Reason | None = None
        self._read()

    def look(self, frame: Frame, odom_from_depth: Pose) -> None:
        """Look at a tracked frame, until this flight is found in the earlier map.

        About 20 ms, three times a second.
        """
        earlier = self._earlier
        self._began_s = min(self._began_s, frame.stamp_s)
        every_s = _LOOK_EVERY_S if frame.stamp_s - self._began_s < _SOON_S else _RARELY_EVERY_S
        if earlier is None or frame.stamp_s - self._looked_s < every_s:
            return
        self._looked_s = frame.stamp_s
        found = earlier.place(PreparedView(frame), odom_from_depth)
        if found is not None:
            self._placed.append(_PlacedView(odom_from_depth, found))
            self._decide()

    def update(self, *, at_rest: bool, wrong: bool) -> None:
        """Write the map if the vehicle rests after a motion. Call it about once a second.

        wrong: odometry is wrong now.
        """
        self._wrong |= wrong
        if at_rest:
            self._moved = self._moved and not self._write()
        else:
            self._moved = True

    def close(self) -> None:
        """Write the map if the vehicle has moved since the last write. The executor runs it."""
        if self._moved:
            self._write()

    def _read(self) -> None:
        try:
            self._earlier = FlownMap.from_bytes(self._file.read_bytes())
        except FileNotFoundError:
            return
        except (OSError, ForeignMapError) as error:
            self._foreign = isinstance(error, ForeignMapError)
            text = (error.strerror or "") if isinstance(error, OSError) else str(error)
            self.reason = Reason(ReasonCode.EARLIER_MAP_IGNORED, (text,))
        else:
            self.reason = Reason(ReasonCode.EARLIER_MAP_SEARCHED, (self._earlier.count,))
        _LOG.info("%s: %s", self._file, self.reason.text())

    def _decide(self) -> None:
        """Take the place that views from different directions agree on, and hardly any contradicts."""
        newest = self._placed[-1]
        same = [view for view in self._placed if view.agrees(newest)]
        enough = len(same) >= max(_AGREEING, math.ceil(_AGREEING_SHARE * len(self._placed)))
        if not (enough and any(view.is_apart(newest) for view in same)):
            return
        self.earlier_from_odom = found = _mean(same)
        self._earlier = None
        x, y, z = found.translation_m.tolist()
        self.reason = Reason(ReasonCode.EARLIER_MAP_FOUND, (x, y, z, math.degrees(found.yaw_rad())))
        _LOG.info("%s: %s", self._file, self.reason.text())

    def _write(self) -> bool:
        """Start a write. Return False if the one before is not done yet."""
        if self._pending is not None and not self._pending.done():
            return False
        surfaces = self._surfaces()
        if surfaces.count >= _FEWEST_KEYFRAMES and not (self._foreign or self._wrong):
            file, arrays = self._file, copied(surfaces)
            self._pending = self._executor.submit(lambda: write(file, arrays), _WRITE_COST_S)
        return True


class NoKeptMap:
    """No file: a flight looks for nothing, and leaves nothing."""

    reason: Reason | None = None

    def look(self, frame: Frame, odom_from_depth: Pose) -> None:
        """Do nothing."""

    def update(self, *, at_rest: bool, wrong: bool) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


def write(file: Path, arrays: dict[str, AnyArray]) -> None:
    """Replace the file by a copied map, atomically, also across a loss of power.

    A folder that cannot be written is logged and changes nothing.
    """
    try:
        atomic_file.replace(file, file_of(arrays), durable=True)
    except OSError as error:
        _LOG.warning("%s: cannot be written (%s)", file, error.strerror)


def is_map(file: Path) -> bool:
    """Return True if a flight could have left this file. Raises OSError."""
    try:
        FlownMap.from_bytes(file.read_bytes())
    except ForeignMapError:
        return False
    return True


def _mean(views: list[_PlacedView]) -> Pose:
    """Return the mean transform of views that agree. It is best where they were."""
    yaws = [view.earlier_from_odom.yaw_rad() for view in views]
    yaw = math.atan2(sum(map(math.sin, yaws)), sum(map(math.cos, yaws)))
    eye_m = np.mean([view.eye_m for view in views], axis=0)
    there_m = np.mean([view.earlier_from_odom.apply(view.eye_m) for view in views], axis=0)
    turn = Pose.from_yaw(yaw, np.zeros(3))
    return Pose(turn.quat_wxyz, there_m - turn.apply(eye_m))
