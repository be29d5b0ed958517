"""Simulated autopilots: the parts common to PX4 and ArduCopter."""
