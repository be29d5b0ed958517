"""Measured values: lap times, speed of this machine, result files and printed tables."""
