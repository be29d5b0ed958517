"""Fusion: a Kalman filter over late poses and inertial samples, with checks of its inputs."""
