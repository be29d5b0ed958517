"""Propagation models: the inertial sensors that carry the state from pose to pose.

The models form a chain. Each next one needs fewer sensors and knows less of the motion between two poses.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class PropagationModel:
    """A model, and the densities of white noise and random walks with it.

    With ``accelerometer`` the offset is tilt error and accelerometer bias together; without it, the acceleration of the body.
    With ``gyro`` the bias is that of the gyro; without it, the negative turn rate of the body. See error_propagation.dynamics.

    acceleration: m/s² per root Hz. offset_walk: m/s² per root second. rate: rad/s per root Hz.
    bias_walk: rad/s per root second. bias_start, offset_start: initial standard deviations, rad/s and m/s².
    """

    gyro: bool
    accelerometer: bool
    acceleration: float
    offset_walk: float
    rate: float
    bias_walk: float
    bias_start: float
    offset_start: float


# A flying camera's IMU (KAIST VIO, a D435i on a quadrotor: 0.07 m/s² and 0.001 rad/s per root Hz). The rate also covers stamps
# that are off by 5 ms in a hard brake. The offset starts as that of a mount that is off by 1.5 degrees.
INERTIAL = PropagationModel(
    gyro=True, accelerometer=True, acceleration=0.08, offset_walk=0.03, rate=0.005, bias_walk=3e-4, bias_start=0.02,
    offset_start=0.3,
)  # fmt: skip
GYRO = PropagationModel(
    gyro=True, accelerometer=False, acceleration=0.1, offset_walk=1.2, rate=0.005, bias_walk=3e-4, bias_start=0.02,
    offset_start=1.0,
)  # fmt: skip
# The walk of the turn rate covers a vehicle that leans by 0.1 rad within an eighth of a second to brake.
KINEMATIC = PropagationModel(
    gyro=False, accelerometer=False, acceleration=0.1, offset_walk=1.2, rate=0.05, bias_walk=4.0, bias_start=2.0,
    offset_start=1.0,
)  # fmt: skip
