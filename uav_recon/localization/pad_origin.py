"""Origin of the world at the take-off pad, for a pose source whose own origin is elsewhere.

Fence, home and the declared free space hang on the pose of the body on the pad. The heading and the position of the source are
measured there at rest; its roll and pitch are kept, because they show where down is. The heading of the body on the pad is
declared: the axes of the fence need not be those of the vehicle.
"""

from __future__ import annotations

import json
import logging
import math
from collections import deque
from contextlib import suppress
from pathlib import Path

import numpy as np

from uav_recon import atomic_file
from uav_recon.interfaces import Channel, PoseSource
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode
from uav_recon.types.vehicle import VehicleState

LOG = logging.getLogger(__name__)

_REST_S = 0.5  #: refuse: no odometry before the pose source was at rest on the pad for this time
_REST_POSES = 5  #: refuse: nor with fewer poses in it
_REST_M = 0.03  #: refuse: at rest, the positions of a source differ by less
_REST_RAD = math.radians(2.0)  #: refuse: at rest, the headings of a source differ by less
_FAR_M = 0.1  #: internal: a pad that is farther from the source's origin is reported
_TURNED_RAD = math.radians(3.0)  #: internal: a pad whose heading differs by more is reported


_COMPLAIN_S = 3.0  #: warn: poses come for this time, and the source was not at rest
_AWAITED = Reason(ReasonCode.PAD_AWAITED, (_REST_S,))


class PadOrigin:
    """A pose source in the world, which begins at the pad; no pose before the pad is known.

    source: the poses as they come. vehicle: tells whether the vehicle is in the air. file: keeps the pad for a restart in the
    air. heading_rad: of the body on the pad, in the world of the fence. ``reason``: that the pad is awaited; then None, or
    where the world begins in the source's frame if that is not its origin.
    """

    def __init__(self, source: PoseSource, vehicle: Channel[VehicleState], file: Path, *, heading_rad: float = 0.0) -> None:
        self._source = source
        self._world_from_pad = Pose.from_yaw(heading_rad, np.zeros(3))
        self._vehicle = vehicle
        self._file = file
        self._rest: deque[StampedPose] = deque()
        self._world_from_source: Pose | None = None
        self.reason: Reason | None = _AWAITED
        self._poses_since_s = math.inf

    def poses(self) -> list[StampedPose]:
        """Return the poses since the last call, in the world, oldest first."""
        poses = self._source.poses()
        if self._world_from_source is None:
            poses = self._find_pad(poses)
        world = self._world_from_source
        return [] if world is None else [pose.moved(world) for pose in poses]

    def _find_pad(self, poses: list[StampedPose]) -> list[StampedPose]:
        """Look for the pad; returns the poses from then on."""
        state = self._vehicle.latest()
        if state is not None and state.armed:  # a restart in the air, which is no pad
            if (kept := _load(self._file)) is not None:
                self._set(kept)
            return poses
        for index, pose in enumerate(poses):
            if self._at_rest(pose):
                self._set(self._world_from_pad @ _pad(self._rest))
                with suppress(OSError):  # without the file a restart in the air finds no pad, and the vehicle lands
                    _save(self._file, self._world_from_source)
                return poses[index:]
            self._complain(pose.stamp_s)
        return []

    def _complain(self, stamp_s: float) -> None:
        """Log once that poses come and do not rest."""
        self._poses_since_s = min(self._poses_since_s, stamp_s)
        if stamp_s - self._poses_since_s > _COMPLAIN_S:
            LOG.warning("%s", _AWAITED.text())
            self._poses_since_s = math.nan

    def _at_rest(self, pose: StampedPose) -> bool:
        if pose.quality <= 0 or not math.isfinite(pose.stamp_s):
            return False
        rest = self._rest
        if rest and (not 0.0 < pose.stamp_s - rest[-1].stamp_s < _REST_S or _apart(rest[0], pose)):
            rest.clear()
        rest.append(pose)
        return len(rest) >= _REST_POSES and pose.stamp_s - rest[0].stamp_s >= _REST_S

    def _set(self, world_from_source: Pose) -> None:
        self.reason = None
        self._world_from_source = world_from_source
        source_from_world = world_from_source.inverse()
        away_m, turn_rad = float(np.linalg.norm(source_from_world.translation_m)), source_from_world.yaw_rad()
        if away_m > _FAR_M or abs(turn_rad) > _TURNED_RAD:
            self.reason = Reason(ReasonCode.PAD_IS_ORIGIN, (away_m, math.degrees(turn_rad)))


def _apart(a: StampedPose, b: StampedPose) -> bool:
    """Return True if a body at rest does not have both poses."""
    way_m = float(np.linalg.norm(a.odom_from_body.translation_m - b.odom_from_body.translation_m))
    turn_rad = math.remainder(a.odom_from_body.yaw_rad() - b.odom_from_body.yaw_rad(), math.tau)
    return not (way_m <= _REST_M and abs(turn_rad) <= _REST_RAD)


def _pad(rest: deque[StampedPose]) -> Pose:
    """Return pad_from_source: the inverse of the median position and the mean heading."""
    place_m = np.median([pose.odom_from_body.translation_m for pose in rest], axis=0)
    first_rad = rest[0].odom_from_body.yaw_rad()
    turns_rad = [math.remainder(pose.odom_from_body.yaw_rad() - first_rad, math.tau) for pose in rest]
    return Pose.from_yaw(first_rad + sum(turns_rad) / len(turns_rad), place_m).inverse()


def _save(file: Path, world_from_source: Pose | None) -> None:
    assert world_from_source is not None
    numbers = [*world_from_source.quat_wxyz.tolist(), *world_from_source.translation_m.tolist()]
    # not durable: it serves a restart of the process, in a folder that a start of the machine empties
    atomic_file.replace(file, json.dumps(numbers).encode(), durable=False)


def _load(file: Path) -> Pose | None:
    try:
        numbers = np.array(json.loads(file.read_text()), dtype=np.float64)
        return Pose(numbers[:4], numbers[4:])
    except (OSError, ValueError, TypeError, IndexError):
        return None
