"""Faults of the configuration: axes or signs of poses, camera and inertial sensor."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from sitl.faults.injectors import inertial_sensor, pose_stream
from sitl.faults.injectors.base import InjectionContext, Injector, StreamedImuSample
from sitl.geometry.quaternion import Quat, from_yaw, multiply
from sitl.world.pose_tracker import PoseRecord

LEFT: Quat = from_yaw(math.pi / 2)
UPSIDE_DOWN: Quat = (0.0, 1.0, 0.0, 0.0)  # a half turn about x: also FRD seen from FLU
_FLIP = np.array([1.0, -1.0, -1.0])


class CameraTurned(Injector):
    """A camera that is mounted otherwise than configured, with its IMU."""

    def __init__(self, quat_wxyz: Quat) -> None:
        self._quat_wxyz = quat_wxyz

    def begin(self, at: InjectionContext) -> None:
        """Turn the camera about the body's origin."""
        at.world.turn_camera(self._quat_wxyz)


def ned(record: PoseRecord, _: float) -> PoseRecord:
    """Return a pose in NED of a body in FRD, in place of ENU and FLU."""
    return dataclasses.replace(
        record, position_m=record.position_m * _FLIP, quat_wxyz=record.quat_wxyz * np.array([1.0, *_FLIP])
    )


def body_turned(turn: Quat) -> pose_stream.Change:
    """Return a change to a source whose body axes are turned against the true ones."""

    def change(record: PoseRecord, _: float) -> PoseRecord:
        w, x, y, z = record.quat_wxyz.tolist()
        return dataclasses.replace(record, quat_wxyz=np.array(multiply((w, x, y, z), turn)))

    return change


def height_negated(record: PoseRecord, _: float) -> PoseRecord:
    """Return a pose whose height has the wrong sign."""
    return dataclasses.replace(record, position_m=record.position_m * np.array([1.0, 1.0, -1.0]))


def imu_axes(*rows: tuple[float, float, float]) -> inertial_sensor.Change:
    """Return a change that assigns other true axes to those of the IMU: a row for each."""
    matrix = np.array(rows)
    return lambda sample, _: StreamedImuSample(sample.stamp_s, matrix @ sample.gyro_radps, matrix @ sample.specific_force_mps2)
