"""Axis monitor: wrong axes or signs of poses, camera mount and inertial sensor.

The three measure one motion. If axes are swapped or turned, two of them agree under another assignment of the axes, and not as
configured. Three comparisons, until each has shown that the configured axes are right:

- on the ground, the specific force at rest points up in the attitude of the poses;
- the turns of the gyro are those of the poses, and the accelerations of the accelerometer too;
- surfaces stay where they are while the poses move the camera.

A comparison finds a fault only if another assignment explains what neither the configured one nor a camera at rest explains.
Sensors that are merely bad, such as poses that drift or an accelerometer with an offset, fit no assignment.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from typing import NamedTuple

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.localization.consistency.planar_patches import patches
from uav_recon.localization.consistency.point_to_plane import seen_at
from uav_recon.types.camera import Frame, ImuSample
from uav_recon.types.frames import AnyArray, FloatArray
from uav_recon.types.pose import Pose, StampedPose
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

GRAVITY_MPS2 = 9.81
_HISTORY_S = 2.0  #: internal: poses and inertial samples are kept for this time
_GAP_S = 0.3  #: internal: no pose is interpolated over a longer gap
# gravity
_TILT_RAD = math.radians(20.0)  #: refuse: at rest the specific force is farther off the poses' vertical; honest: 3 degrees
_FORCE_MPS2 = 1.0  #: internal: at rest the specific force differs less from gravity
_REST_RADPS = 0.1  #: internal: at rest no turn rate is larger
_REST_M = 0.03  #: internal: at rest the poses of _REST_S differ by less
_REST_S = 0.5  #: refuse: time at rest before the vertical is compared
# gyro
_TURN_S = 0.4  #: internal: time over which turns are compared
_TURN_RAD = math.radians(0.4)  # standard deviation of the difference of two such turns, per axis
_TURN_NIS = 50.0  #: land: squared deviations by which another assignment fits the turns better; honest: below 0
_FORCE_NIS = 12.0  #: land: the same for velocities; poses with a height of the wrong sign make the autopilot run away
#: internal: squared deviations by which every other assignment is worse, once the configured one has proven right
_PROVEN_NIS = 60.0
_EXPLAINED_SHARE = 0.4  #: land: share of the squared deviations that the other assignment leaves at most
_HALF_S = 0.15  #: internal: velocities are compared between one such time and the next
_GAINED_MPS = 0.12  # standard deviation of the difference of two such changes of the velocity, per axis
# depth
_DELAYS_S = (0.0, 0.02, 0.04)  #: land: frames may be older than their stamps by these; the one that fits best counts
_VIEW_S = 0.15  #: internal: interval of the views that are compared
_AGE_S = 0.5  #: internal: max. age of a compared view
_MOVED_M = 0.05  #: land: a camera that moved by less between two views is not compared
_TURNED_RAD = math.radians(5.0)  #: land: ... and turned by less
_MIN_PATCHES = 60  #: land: min. patches that both views see
#: land: mean misfit as configured above which others are tried; 0: exact, 1: nothing fits; honest: 0.1 to 0.3
_MISFIT_SHARE = 0.32
_FITTING_SHARE = 0.35  #: land: max. mean misfit under the other assignment
_IN_VIEW_SHARE = 0.6  #: land: share of the patches that both views see under the other assignment, too
_GAIN_SHARE = 0.10  #: land: the other assignment has a misfit that is smaller by this, also than that of a camera at rest
#: land: the configured axes fit worse than a camera at rest less this: an exchanged axis is at least 90 degrees off
_NO_BETTER_SHARE = 0.12
_IN_A_ROW = 3  #: land: comparisons in a row that must find a fault
_LASTS_S = 0.3  #: land: ... for this time
_PROVEN_M = 1.0  #: internal: level motion after which depth and poses have proven to agree, with
_PROVEN_UP_M = 0.4  #: internal: ... this much up or down, and
_PROVEN_RAD = math.radians(60.0)  #: internal: ... turned by this much
_FACING_COS = 0.1  # a patch seen at a flatter angle, or from behind, is not compared
_WAITING = 6  # frames that wait for a pose

_SIGNED = tuple(
    np.array(
        [[sign * (column == axis) for column in range(3)] for axis, sign in zip(axes, signs, strict=True)], dtype=np.float64
    )
    for axes in itertools.permutations(range(3))
    for signs in itertools.product((1.0, -1.0), repeat=3)
)
# assignments of axes (48, 3, 3), the configured one first; a rotation or a mirror image
ASSIGNMENTS = np.array(sorted(_SIGNED, key=lambda matrix: -float(np.trace(matrix))))
_TURNS = ASSIGNMENTS[np.linalg.det(ASSIGNMENTS) > 0.0]  # (24, 3, 3)


class _View(NamedTuple):
    stamp_s: float
    patches: AnyArray  # (N, 6), axes of the imager
    odom_from_body: list[Pose]  # for each of _DELAYS_S
    body_from_depth: Pose


_NO_PATCHES = np.empty((0, 6))
_NONE = np.empty((0, 3, 3))


class AxisMonitor:
    """Compares poses, inertial samples and depth frames, as they come.

    About 0.4 ms per frame; not thread-safe.

    ``reason``: None, or which axes are wrong. It stays: no flight changes how a sensor is mounted.
    """

    def __init__(self) -> None:
        self.reason: Reason | None = None
        self._poses: deque[StampedPose] = deque()
        self._depth = _DepthAgainstPoses()
        self._gyro = _GyroAgainstPoses()
        self._force = _ForceAgainstPoses()
        self._gravity = _GravityAgainstPoses()
        self._waiting: deque[tuple[Frame, Pose]] = deque(maxlen=_WAITING)

    def add_imu(self, samples: list[ImuSample]) -> None:
        """Add inertial samples, oldest first."""
        for sample in samples:
            self._gyro.add(sample)
            self._force.add(sample)
            self._gravity.add(sample)

    def forget(self) -> None:
        """Forget the newest poses; the evidence of those before them stays."""
        self._poses.clear()
        self._waiting.clear()
        self._depth.forget()

    def add_pose(self, pose: StampedPose) -> None:
        """Compare a pose with the inertial samples, and the frames before it with earlier ones."""
        if pose.quality <= 0 or not math.isfinite(pose.stamp_s) or (self._poses and pose.stamp_s <= self._poses[-1].stamp_s):
            return
        if self._poses and pose.reset_counter != self._poses[-1].reset_counter:
            self._poses.clear()
            self._depth.forget()
        self._poses.append(pose)
        while pose.stamp_s - self._poses[0].stamp_s > _HISTORY_S:
            self._poses.popleft()
        self._record_fault(self._gravity.fault(self._poses) or self._gyro.fault(self._poses) or self._force.fault(self._poses))
        while self._waiting and self._waiting[0][0].stamp_s <= pose.stamp_s:
            frame, body_from_depth = self._waiting.popleft()
            there = self._poses_at([frame.stamp_s - delay_s for delay_s in _DELAYS_S])
            if len(there) == len(_DELAYS_S):
                self._record_fault(self._depth.fault(frame, there, body_from_depth))

    def add_frame(self, frame: Frame, body_from_depth: Pose) -> None:
        """Add a depth frame; it is compared once the pose after it is known."""
        if not self._depth.proven:
            self._waiting.append((frame, body_from_depth))

    def _record_fault(self, reason: Reason | None) -> None:
        self.reason = self.reason or reason

    def _poses_at(self, stamps_s: list[float]) -> list[Pose]:
        """Return the poses that are known of these instants."""
        return [pose for stamp_s in stamps_s if (pose := self._pose_at(stamp_s)) is not None]

    def _pose_at(self, stamp_s: float) -> Pose | None:
        later = next((k for k, pose in enumerate(self._poses) if pose.stamp_s >= stamp_s), 0)
        if later == 0:
            return None
        before, after = self._poses[later - 1], self._poses[later]
        span_s = after.stamp_s - before.stamp_s
        if span_s > _GAP_S:
            return None
        share, a, b = (stamp_s - before.stamp_s) / span_s, before.odom_from_body, after.odom_from_body
        same_way = 1.0 if float(a.quat_wxyz @ b.quat_wxyz) >= 0.0 else -1.0
        quat = (1.0 - share) * a.quat_wxyz + share * same_way * b.quat_wxyz
        return Pose(quat, (1.0 - share) * a.translation_m + share * b.translation_m)


class _GravityAgainstPoses:
    """The specific force at rest on the ground, before the first motion."""

    def __init__(self) -> None:
        self._forces: deque[tuple[float, FloatArray]] = deque()
        self._moved = False

    def add(self, sample: ImuSample) -> None:
        if self._moved:
            return
        force = sample.specific_force_mps2
        at_rest = float(np.abs(sample.gyro_radps).max()) < _REST_RADPS
        if not (at_rest and abs(float(np.linalg.norm(force)) - GRAVITY_MPS2) < _FORCE_MPS2):
            self._forces.clear()
            return
        self._forces.append((sample.stamp_s, force))
        while sample.stamp_s - self._forces[0][0] > 2.0 * _REST_S:
            self._forces.popleft()

    def fault(self, poses: deque[StampedPose]) -> Reason | None:
        newest = poses[-1]
        lately = [pose for pose in poses if newest.stamp_s - pose.stamp_s <= _REST_S]
        apart_m = np.ptp([pose.odom_from_body.translation_m for pose in lately], axis=0)
        self._moved = self._moved or float(apart_m.max()) > 2.0 * _REST_M
        rested_s = self._forces[-1][0] - self._forces[0][0] if self._forces else 0.0
        if self._moved or rested_s < _REST_S or float(apart_m.max()) > _REST_M:
            return None
        up = newest.odom_from_body.rotation() @ np.mean([force for _, force in self._forces], axis=0)
        tilt_rad = math.acos(max(min(float(up[2] / np.linalg.norm(up)), 1.0), -1.0))
        return Reason(ReasonCode.AXES_GRAVITY, (math.degrees(tilt_rad),)) if tilt_rad > _TILT_RAD else None


class _Evidence:
    """Sums of squared differences of two vectors of one motion, one for each assignment."""

    def __init__(self, sure: float) -> None:
        self._sure = sure
        self.squares = np.zeros(len(ASSIGNMENTS))
        self.proven = False  # every other assignment is surely worse than the configured one

    def add(self, one: FloatArray, other: FloatArray, weight: float = 1.0) -> FloatArray | None:
        """Add two vectors (3,) in standard deviations.

        Return the assignment that surely fits better, None for none.
        """
        self.squares += weight * np.sum((ASSIGNMENTS @ one - other) ** 2, axis=1)
        best = int(np.argmin(self.squares))
        configured, least = float(self.squares[0]), float(self.squares[best])
        self.proven = float(np.min(self.squares[1:])) - configured > _PROVEN_NIS
        return ASSIGNMENTS[best] if configured - least > self._sure and least < _EXPLAINED_SHARE * configured else None


class _ForceAgainstPoses:
    """Changes of velocity by the accelerometer and by the positions of the poses."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, FloatArray]] = deque()
        self._compared_s = -math.inf
        self._evidence = _Evidence(_FORCE_NIS)

    def add(self, sample: ImuSample) -> None:
        if self._evidence.proven or (self._samples and sample.stamp_s <= self._samples[-1][0]):
            return
        self._samples.append((sample.stamp_s, sample.specific_force_mps2))
        while sample.stamp_s - self._samples[0][0] > _HISTORY_S:
            self._samples.popleft()

    def fault(self, poses: deque[StampedPose]) -> Reason | None:
        end = poses[-1]
        middle = next((pose for pose in reversed(poses) if end.stamp_s - pose.stamp_s >= _HALF_S), None)
        if self._evidence.proven or middle is None:
            return None
        begin = next((pose for pose in reversed(poses) if middle.stamp_s - pose.stamp_s >= _HALF_S), None)
        if begin is None or end.stamp_s - begin.stamp_s > 4.0 * _HALF_S:
            return None
        imu_mps = self._gained_mps(begin.stamp_s, middle, end.stamp_s)
        if imu_mps is None:
            return None
        new_s = min(end.stamp_s - self._compared_s, end.stamp_s - begin.stamp_s)
        self._compared_s = end.stamp_s
        poses_mps = _velocity_mps(middle, end) - _velocity_mps(begin, middle)
        best = self._evidence.add(imu_mps / _GAINED_MPS, poses_mps / _GAINED_MPS, new_s / (end.stamp_s - begin.stamp_s))
        return None if best is None else Reason(ReasonCode.AXES_FORCE, (_named(best),))

    def _gained_mps(self, begin_s: float, middle: StampedPose, end_s: float) -> FloatArray | None:
        """Return the change (3,) of the mean velocity at the middle, None without samples."""
        inside = [(stamp_s, force) for stamp_s, force in self._samples if begin_s < stamp_s <= end_s]
        if len(inside) < 5 or inside[0][0] - begin_s > 0.1 or end_s - inside[-1][0] > 0.1:
            return None
        rotation, before_s, gained = middle.odom_from_body.rotation(), begin_s, np.zeros(3)
        halves_s = middle.stamp_s - begin_s, end_s - middle.stamp_s
        for stamp_s, force in inside:
            early = stamp_s <= middle.stamp_s
            share = (stamp_s - begin_s) / halves_s[0] if early else (end_s - stamp_s) / halves_s[1]
            gained += share * (stamp_s - before_s) * (rotation @ force - (0.0, 0.0, GRAVITY_MPS2))
            before_s = stamp_s
        return gained


class _GyroAgainstPoses:
    """Turns of the gyro and of the poses."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, FloatArray]] = deque()
        self._since: StampedPose | None = None
        self._evidence = _Evidence(_TURN_NIS)

    def add(self, sample: ImuSample) -> None:
        if self._evidence.proven or (self._samples and sample.stamp_s <= self._samples[-1][0]):
            return
        self._samples.append((sample.stamp_s, sample.gyro_radps))
        while sample.stamp_s - self._samples[0][0] > _HISTORY_S:
            self._samples.popleft()

    def fault(self, poses: deque[StampedPose]) -> Reason | None:
        newest, since = poses[-1], self._since
        if self._evidence.proven or (since is not None and newest.stamp_s - since.stamp_s < _TURN_S):
            return None
        self._since = newest
        if since is None or newest.stamp_s - since.stamp_s > 2.0 * _TURN_S or since.reset_counter != newest.reset_counter:
            return None
        gyro_rad = self._turned_rad(since.stamp_s, newest.stamp_s)
        if gyro_rad is None:
            return None
        turn = since.odom_from_body.inverse() @ newest.odom_from_body
        poses_rad = turn.rotation_vector()
        best = self._evidence.add(gyro_rad / _TURN_RAD, poses_rad / _TURN_RAD)
        return None if best is None else Reason(ReasonCode.AXES_GYRO, (_named(best.T),))

    def _turned_rad(self, from_s: float, to_s: float) -> FloatArray | None:
        """Return the gyro's rotation vector (3,) between two instants, None without samples."""
        inside = [(stamp_s, rate) for stamp_s, rate in self._samples if from_s < stamp_s <= to_s]
        if len(inside) < 5 or inside[0][0] - from_s > 0.1 or to_s - inside[-1][0] > 0.1:
            return None
        turn, before_s = Pose.identity(), from_s
        for stamp_s, rate in inside:
            turn = turn @ Pose.from_rotation_vector((stamp_s - before_s) * rate, np.zeros(3))
            before_s = stamp_s
        return turn.rotation_vector()


class _DepthAgainstPoses:
    """Surfaces of earlier views, at the place that the poses give them in a frame.

    If they are elsewhere, each assignment of the axes of the body, and of those of the position alone, is tried.
    """

    def __init__(self) -> None:
        self.proven = False
        self._views: deque[_View] = deque()
        self._row, self._since_s = 0, -math.inf
        self._agreed = np.zeros(3)  # level motion (m), up or down (m), turn (rad)
        self._compared_s = -math.inf

    def forget(self) -> None:
        """Forget the views, after a jump of the poses."""
        self._views.clear()

    def fault(self, frame: Frame, odom_from_body: list[Pose], body_from_depth: Pose) -> Reason | None:
        """Compare a frame with a view. odom_from_body: at its stamp less each of _DELAYS_S."""
        while self._views and not 0.0 < frame.stamp_s - self._views[0].stamp_s <= _AGE_S:
            self._views.popleft()
        here = _View(frame.stamp_s, _NO_PATCHES, odom_from_body, body_from_depth)
        found = self._compare(self._views[0], here, frame) if self._views else None
        if not self._views or frame.stamp_s - self._views[-1].stamp_s >= _VIEW_S:
            seen = patches(frame.depth_m, frame.depth_intrinsics.pinhole_px(), np.eye(3), np.zeros(3))
            self._views.append(here._replace(patches=seen))
        return found

    def _compare(self, view: _View, here: _View, frame: Frame) -> Reason | None:
        shift_m = here.odom_from_body[0].translation_m - view.odom_from_body[0].translation_m
        turned_rad = float(np.linalg.norm((view.odom_from_body[0].inverse() @ here.odom_from_body[0]).rotation_vector()))
        if float(np.linalg.norm(shift_m)) < _MOVED_M and turned_rad < _TURNED_RAD:
            return None
        seen = view.patches, frame.depth_m, frame.depth_intrinsics.pinhole_px()
        configured = misfits(*seen, *_as_assigned(view, here, _TURNS[:1], _NONE))
        count, misfit = float(configured[0, 0]), float(configured[:, 1].min())
        in_view, still = misfits(*seen, np.eye(3)[None], np.zeros((1, 3)))[0]
        if count < max(_MIN_PATCHES, _IN_VIEW_SHARE * in_view):
            return None
        if misfit <= _MISFIT_SHARE:
            self._row = 0
            self._agree(here.stamp_s, view.stamp_s, np.array([math.hypot(*shift_m[:2]), abs(float(shift_m[2])), turned_rad]))
            return None
        others = misfits(*seen, *_as_assigned(view, here, _TURNS, ASSIGNMENTS))
        others[others[:, 0] < _IN_VIEW_SHARE * count, 1] = np.inf
        best = int(np.argmin(others[:, 1])) // len(_DELAYS_S)
        least = float(others[:, 1].min())
        opposed = misfit > still - _NO_BETTER_SHARE
        if not (opposed and least < _FITTING_SHARE and min(misfit, still) - least > _GAIN_SHARE):
            self._row = 0
            return None
        self._since_s = here.stamp_s if self._row == 0 else self._since_s
        self._row += 1
        if self._row < _IN_A_ROW or here.stamp_s - self._since_s < _LASTS_S:
            return None
        named = _TURNS[best] if best < len(_TURNS) else ASSIGNMENTS[best - len(_TURNS)].T
        return Reason(ReasonCode.AXES_DEPTH, (_named(named),))

    def _agree(self, stamp_s: float, then_s: float, moved: FloatArray) -> None:
        """Count the motion since the last comparison, of one that fits."""
        new_s = min(stamp_s - self._compared_s, stamp_s - then_s)
        self._compared_s = stamp_s
        self._agreed += new_s / (stamp_s - then_s) * moved
        self.proven = bool(np.all(self._agreed >= (_PROVEN_M, _PROVEN_UP_M, _PROVEN_RAD)))


def _as_assigned(view: _View, here: _View, turns: FloatArray, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return K rotations (K, 3, 3) and places (K, 3): each assignment with each delay.

    They are those of the imager in the one of the view. First come the rotations of the body's axes against the imager's
    (turns), then the assignments of the position alone (places).
    """
    then, now = view.body_from_depth, here.body_from_depth
    moves = [a.inverse() @ b for a, b in zip(view.odom_from_body, here.odom_from_body, strict=True)]
    rotations_body = [move.rotation() for move in moves]
    bodies = [
        (axes.T @ turn @ axes, axes.T @ move.translation_m)
        for axes in turns
        for move, turn in zip(moves, rotations_body, strict=True)
    ]
    for axes in places:
        for a, b, turn in zip(view.odom_from_body, here.odom_from_body, rotations_body, strict=True):
            bodies.append((turn, a.rotation().T @ axes @ (b.translation_m - a.translation_m)))
    back, forth, rotation_now = then.rotation().T, now.translation_m, now.rotation()
    rotations = np.array([back @ turn @ rotation_now for turn, _ in bodies])
    shifts = np.array([back @ (turn @ forth + shift_m - then.translation_m) for turn, shift_m in bodies])
    return rotations, shifts


@kernel
def misfits(then: AnyArray, depth_m: AnyArray, camera: AnyArray, rotations: AnyArray, places: AnyArray) -> AnyArray:
    """Return for K camera poses the number of patches in view and their mean misfit, (K, 2).

    then: (N, 6), patches of an earlier view in the frame of the poses; depth_m (H, W), NaN = no return; camera fx, fy, cx, cy;
    rotations (K, 3, 3), places (K, 3) of the camera. A misfit is the distance from the plane of the patch, as a share of what
    noise and pose may give, at most 1.
    """
    out = np.zeros((len(rotations), 2))
    for k in range(len(rotations)):
        rotation, place = rotations[k], places[k]
        count, total = 0, 0.0
        for n in range(len(then)):
            away, facing = 0.0, 0.0
            for i in range(3):
                away += (then[n, i] - place[i]) ** 2
                facing += (then[n, i] - place[i]) * then[n, 3 + i]
            if facing < _FACING_COS * math.sqrt(away):
                continue
            u, v, _ = seen_at(then[n], camera, rotation, place)
            if not (0 <= u < depth_m.shape[1] and 0 <= v < depth_m.shape[0]):
                continue
            z = float(depth_m[v, u])
            if not np.isfinite(z):
                continue
            x, y = (u - camera[2]) / camera[0] * z, (v - camera[3]) / camera[1] * z
            off_m = 0.0
            for i in range(3):
                there = rotation[i, 0] * x + rotation[i, 1] * y + rotation[i, 2] * z + place[i]
                off_m += (there - then[n, i]) * then[n, 3 + i]
            count += 1
            total += min(abs(off_m) / (0.03 + 0.01 * z * z), 1.0)
        out[k, 0] = count
        out[k, 1] = total / count if count else 1.0
    return out


def _velocity_mps(before: StampedPose, after: StampedPose) -> FloatArray:
    """Return the mean velocity (3,) between two poses."""
    shift_m = after.odom_from_body.translation_m - before.odom_from_body.translation_m
    return np.asarray(shift_m / (after.stamp_s - before.stamp_s))


def _named(assignment: FloatArray) -> str:
    """Return an assignment as text: which true axis each configured axis is."""
    parts = []
    for row in assignment:
        axis = int(np.argmax(np.abs(row)))
        parts.append(("-" if row[axis] < 0.0 else "") + "xyz"[axis])
    return " ".join(parts)


def warm_up() -> None:
    """Compile every kernel, for the read-only arrays of a frame and a pose."""
    depth_m = np.full((24, 32), 2.0, dtype=np.float32)
    depth_m.setflags(write=False)
    camera = np.array([20.0, 20.0, 15.5, 11.5])
    seen = patches(depth_m, camera, np.eye(3), np.zeros(3))
    misfits(seen, depth_m, camera, np.eye(3)[None], np.zeros((1, 3)))
