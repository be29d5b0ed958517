"""Simulated autopilots: what PX4 and ArduCopter share."""
