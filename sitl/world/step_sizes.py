"""How finely time is cut: for flights that must be as real as possible, and for many flights that must be quick."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StepSizes:
    """physics_s: one step of vehicle and autopilot; turn_s: one turn of all loops in lockstep; imu_hz: of the camera's IMU;
    truth_hz: how often the true path and its clearance are noted.
    """

    physics_s: float
    turn_s: float
    imu_hz: float
    truth_hz: float


REAL = StepSizes(physics_s=0.004, turn_s=0.01, imu_hz=200.0, truth_hz=50.0)
# every rate of the product divides its turns; at 0.8 m/s clearance is noted every 3 cm
QUICK = StepSizes(physics_s=1.0 / 60.0, turn_s=1.0 / 60.0, imu_hz=60.0, truth_hz=30.0)
