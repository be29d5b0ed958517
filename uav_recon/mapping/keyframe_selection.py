"""Keyframe selection: score a frame by the surface that no keyframe has observed well yet.

Each surface voxel needs OBSERVATIONS_PER_VOXEL good observations. An observation has a lower weight if its depth noise is
larger, and each further one of a voxel counts REPEATED times as much as the one before: surface that no keyframe shows comes
first. The gain of a frame is the sum, over its voxels, of what it adds. A frame is selected if its gain reaches the share that
each remaining view must contribute to cover the whole room. So the view budget lasts for the room and is spent on new surface.
While there are openings to explore, a multiple of that share is asked for: the views of tasks that nobody knows yet must be
left.
"""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.jit import kernel
from uav_recon.types.camera import Frame, Intrinsics, PosedFrame
from uav_recon.types.frames import AnyArray, FloatArray
from uav_recon.types.maps import GridSpec
from uav_recon.types.pose import Pose

OBSERVATIONS_PER_VOXEL = 3.0
REPEATED = 1.0 / 3.0  # value of an observation of a voxel as a share of the value of the one before
GOOD_SIGMA_M = 0.02  # depth noise (one sigma) up to which an observation has full weight
PIXEL_STEP = 4
FURNISHED_AREA_RATIO = 1.5  # ratio of the surface area of a furnished room to that of its bounding box
SMALLEST_GAIN = 100.0
FIXED_POINT_SCALE = (
    10_000  # fixed-point counts per observation; FIXED_POINT_SCALE * OBSERVATIONS_PER_VOXEL stays below COUNTED_FLAG
)
COUNTED_FLAG = 1 << 15  # flag bit of a voxel that was already counted in the current frame
BUDGET_RESERVE_FACTOR = 5.0  # factor on the share of a view while the room is explored: leaves budget for the tasks to come
# a frame closer than both to the last keyframe adds nothing new
BASELINE_M = 0.25
BASELINE_RAD = 0.25


class KeyframeSelection:
    """Observation weight that the keyframes gave to each surface voxel."""

    def __init__(
        self, grid: GridSpec, fence_min_m: FloatArray, fence_max_m: FloatArray, noise_px: float, baseline_m: float
    ) -> None:
        self._grid = grid
        self._noise_px = noise_px
        self._baseline_m = baseline_m
        self._looks = np.zeros(grid.shape, dtype=np.uint16)
        self._met = np.zeros(0, dtype=np.int64)
        self._given = 0.0
        a, b, c = np.asarray(fence_max_m, dtype=np.float64) - np.asarray(fence_min_m, dtype=np.float64)
        self._wanted = (
            _value(int(FIXED_POINT_SCALE * OBSERVATIONS_PER_VOXEL))
            * FURNISHED_AREA_RATIO
            * 2.0
            * (a * b + b * c + c * a)
            / grid.resolution_m**2
        )
        self._last: Pose | None = None

    def selects(self, posed: PosedFrame, views_left: int, *, explored: bool) -> bool:
        """Return True if the frame should use one of the remaining views. Takes about 1 ms.

        explored: no opening into unknown space is left, so that no task is to come that nobody knows yet.
        """
        if views_left <= 0 or not self._moved(posed.world_from_depth):
            return False
        missing = max(self._wanted - self.total_observation_weight(), 0.0)
        share = (1.0 if explored else BUDGET_RESERVE_FACTOR) * missing / views_left
        return bool(self._read(posed, keep=False) >= max(share, SMALLEST_GAIN))

    def keep(self, posed: PosedFrame) -> None:
        """Record that the frame became a keyframe."""
        self._last = posed.world_from_depth
        self._read(posed, keep=True)

    def total_observation_weight(self) -> float:
        """Return the sum of the observation weights over all voxels."""
        return self._given

    def warm_up(self) -> None:
        """Compile the kernel on an empty frame; the state does not change."""
        lens = Intrinsics(1.0, 1.0, 0.0, 0.0, 1, 1)
        empty = Frame(0.0, 0, np.full((1, 1), np.nan, np.float32), lens, np.zeros((1, 1, 3), np.uint8), lens, Pose.identity())
        self._read(PosedFrame(empty, Pose.identity()), keep=False)

    def _moved(self, pose: Pose) -> bool:
        if self._last is None:
            return True
        step = self._last.inverse() @ pose
        turn_rad = 2.0 * float(np.arccos(min(abs(float(step.quat_wxyz[0])), 1.0)))
        return float(np.linalg.norm(step.translation_m)) >= BASELINE_M or turn_rad >= BASELINE_RAD

    def _read(self, posed: PosedFrame, *, keep: bool) -> float:
        frame, pose = posed.frame, posed.world_from_depth
        sigma = self._noise_px / (frame.depth_intrinsics.fx * self._baseline_m)
        origin = (pose.translation_m - self._grid.origin_world_m) / self._grid.resolution_m
        rotation = pose.rotation() / self._grid.resolution_m
        if self._met.size < frame.depth_m.size:
            self._met = np.zeros(frame.depth_m.size, dtype=np.int64)
        shape, looks, lens = self._grid.shape, self._looks.reshape(-1), frame.depth_intrinsics.pinhole_px()
        gain: float = _gain(frame.depth_m, lens, rotation, origin, sigma, shape, looks, self._met, keep)
        self._given += gain if keep else 0.0
        return gain


class PlannedViewsOnly:
    """Selects no frame beside the planned views: views at a set spacing need the whole budget."""

    def selects(self, posed: PosedFrame, views_left: int, *, explored: bool) -> bool:
        """Return False."""
        return False

    def keep(self, posed: PosedFrame) -> None:
        """Do nothing."""

    def warm_up(self) -> None:
        """Do nothing: there is no kernel."""


@kernel
def _value(looks: int) -> float:
    """Return the value of the observations of one voxel: 1 for one, 1 + REPEATED for two.

    looks: in counts of FIXED_POINT_SCALE.
    """
    left, each, value = looks / FIXED_POINT_SCALE, 1.0, 0.0
    while left > 0.0:
        value += each * min(left, 1.0)
        left -= 1.0
        each *= REPEATED
    return value


@kernel
def _gain(
    depth_m: AnyArray, lens: AnyArray, rotation: AnyArray, origin: AnyArray, sigma: float,
    shape: tuple[int, int, int], looks: AnyArray, met: AnyArray, keep: bool,
) -> float:  # fmt: skip
    """Return the observation weight that a depth image adds, summed over the voxels it hits.

    Each voxel counts once per frame. looks: flat uint16, in counts of FIXED_POINT_SCALE per observation. met: scratch for the
    indices of the voxels hit.
    """
    gain, number = 0.0, 0
    for v in range(0, depth_m.shape[0], PIXEL_STEP):
        for u in range(0, depth_m.shape[1], PIXEL_STEP):
            z = float(depth_m[v, u])
            if not z > 0.0:
                continue
            x, y = (u - lens[2]) / lens[0] * z, (v - lens[3]) / lens[1] * z
            i = int(np.floor(rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z + origin[0]))
            j = int(np.floor(rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z + origin[1]))
            k = int(np.floor(rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z + origin[2]))
            if not (0 <= i < shape[0] and 0 <= j < shape[1] and 0 <= k < shape[2]):
                continue
            index = (i * shape[1] + j) * shape[2] + k
            given = int(looks[index])
            if given >= COUNTED_FLAG:
                continue
            look = min(
                int(FIXED_POINT_SCALE * min(GOOD_SIGMA_M / (sigma * z * z), 1.0)),
                int(FIXED_POINT_SCALE * OBSERVATIONS_PER_VOXEL) - given,
            )
            gain += _value(given + look) - _value(given)
            looks[index] = COUNTED_FLAG + given + (look if keep else 0)
            met[number] = index
            number += 1
    for n in range(number):
        looks[met[n]] -= COUNTED_FLAG
    return gain
