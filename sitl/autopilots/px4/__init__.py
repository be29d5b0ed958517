"""The simulated PX4."""
