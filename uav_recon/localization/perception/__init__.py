"""Perception: one step from the camera's frames and late poses to odometry and posed frames."""
