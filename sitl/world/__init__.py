"""The simulated vehicle: dynamics, battery, gimbal, IMU, pose tracker."""
