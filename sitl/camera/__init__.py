"""The simulated depth camera."""
