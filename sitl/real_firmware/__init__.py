"""Real firmware binaries (ArduCopter, PX4) in place of the simulated autopilots."""
