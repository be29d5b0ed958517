"""Time steps of the simulation: fine for accurate flights, coarse for many quick flights."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StepSizes:
    """Time steps and rates of a simulated flight.

    physics_s: one step of vehicle and autopilot. iteration_s: one iteration of all loops in lockstep.
    imu_hz: rate of the camera's IMU. truth_hz: rate at which the true path and its clearance are recorded.
    """

    physics_s: float
    iteration_s: float
    imu_hz: float
    truth_hz: float


FINE_STEPS = StepSizes(physics_s=0.004, iteration_s=0.01, imu_hz=200.0, truth_hz=50.0)
# every rate of the product divides the turn rate; at 0.8 m/s clearance is recorded every 3 cm
COARSE_STEPS = StepSizes(physics_s=1.0 / 60.0, iteration_s=1.0 / 60.0, imu_hz=60.0, truth_hz=30.0)
