"""Correction: odometry moved against a drift of its source, by a tracker beside it."""
