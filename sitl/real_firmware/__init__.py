"""Real firmware binaries in place of the simulated autopilots."""
