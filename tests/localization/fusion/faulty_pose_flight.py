"""A flight along the figure of eight whose pose source gets into trouble, and the odometry that came of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from figure_eight import Event, FigureEight, events
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from uav_recon.localization.fusion.fusion_filter import FusionFilter
from uav_recon.types.camera import ImuSample
from uav_recon.types.pose import Pose, PoseHealth, StampedPose

MOTION = FigureEight()
ONSET_S = MOTION.start_s + 4.0
Trouble = Callable[[StampedPose, float], StampedPose | None]  # a pose and the seconds since the onset; None: it never comes


def shifted(x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw_deg: float = 0.0, *, about_origin: bool = True) -> Trouble:
    """Every pose moved, or turned about the map's origin or, like a lost heading, on the spot."""
    turn = Rotation.from_euler("z", yaw_deg, degrees=True)

    def change(pose: StampedPose, _: float) -> StampedPose:
        attitude = turn * Rotation.from_quat(pose.odom_from_body.quat_wxyz, scalar_first=True)
        place = pose.odom_from_body.translation_m.copy()
        place = (turn.apply(place) if about_origin else place) + np.array([x, y, z])
        return replace(pose, odom_from_body=Pose(attitude.as_quat(scalar_first=True), place))

    return change


@dataclass
class FlownOdometry:
    """Odometry at 30 Hz. error_m: (N, 3) beyond the source's drift, in odom."""

    stamps_s: list[float] = field(default_factory=list)
    odom: list[StampedPose] = field(default_factory=list)
    errors_m: list[NDArray[np.float64]] = field(default_factory=list)
    turns_rad: list[float] = field(default_factory=list)
    silent_s: list[float] = field(default_factory=list)  # seconds since the onset without odometry
    fusion: FusionFilter = field(default_factory=FusionFilter)

    def since(self, seconds: float) -> int:
        """Index of the first sample at a time after the onset."""
        return int(np.searchsorted(self.stamps_s, ONSET_S + seconds))

    def step_m(self) -> float:
        """Largest step of odometry from sample to sample beyond the true motion."""
        return float(np.linalg.norm(np.diff(self.errors_m, axis=0), axis=1).max())

    def error_m(self, from_s: float, to_s: float = 1e9) -> float:
        """Largest distance from the truth."""
        rows = self.errors_m[self.since(from_s) : self.since(to_s)]
        return float(np.linalg.norm(rows, axis=1).max())

    def first(self, health: PoseHealth) -> float:
        """Seconds from the onset to the first sample of this health."""
        return (
            next(s for s, odom in zip(self.stamps_s, self.odom, strict=True) if s >= ONSET_S and odom.health is health)
            - ONSET_S
        )

    def healths(self, from_s: float, to_s: float = 1e9) -> set[PoseHealth]:
        return {odom.health for odom in self.odom[self.since(from_s) : self.since(to_s)]}

    def resets(self) -> int:
        return self.odom[-1].reset_counter


def fly(
    trouble: Trouble,
    seconds: float = 3.0,
    seed: int = 5,
    late_s: float = 0.0,
    *,
    imu: bool = True,
    inertial: Callable[[ImuSample, float], ImuSample] = lambda sample, _: sample,
    may_be_silent: bool = False,
) -> FlownOdometry:
    """trouble: what becomes of each pose stamped after the onset, which comes ``late_s`` later than it would; inertial: the
    same of each inertial sample.
    """
    flown, due_s, drift = FlownOdometry(), MOTION.start_s + 2.0, np.zeros(6)
    stream = [_meddled(event, trouble, late_s) for event in events(MOTION, 4.0 + seconds, seed, imu=imu)]
    for event in sorted((event for event in stream if event is not None), key=lambda event: event.arrival_s):
        while event.arrival_s > due_s:
            odom = flown.fusion.odom_at(due_s)
            if may_be_silent and odom is None:
                flown.silent_s.append(due_s - ONSET_S)
                due_s += 1 / 30
                continue
            assert odom
            flown.stamps_s.append(due_s)
            flown.odom.append(odom)
            flown.errors_m.append(odom.odom_from_body.translation_m - MOTION.position(due_s) - drift[:3])
            truth = Rotation.from_rotvec(drift[3:]) * MOTION.attitude(due_s)
            reported = Rotation.from_quat(odom.odom_from_body.quat_wxyz, scalar_first=True)
            flown.turns_rad.append((reported * truth.inv()).magnitude())
            due_s += 1 / 30
        if event.imu:
            flown.fusion.add_imu([inertial(event.imu, event.imu.stamp_s - ONSET_S)])
        elif event.pose:
            flown.fusion.add_pose(event.pose, event.arrival_s)
            drift = drift if event.drift is None else event.drift
    return flown


def _meddled(event: Event, trouble: Trouble, late_s: float) -> Event | None:
    if event.pose is None or event.pose.stamp_s < ONSET_S:
        return event
    pose = trouble(event.pose, event.pose.stamp_s - ONSET_S)
    return None if pose is None else replace(event, pose=pose, arrival_s=event.arrival_s + late_s)
