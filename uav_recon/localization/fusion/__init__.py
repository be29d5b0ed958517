"""Fusion: an error-state Kalman filter over late poses and inertial samples, and what guards it."""
