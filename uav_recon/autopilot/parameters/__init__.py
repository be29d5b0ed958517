"""Autopilot parameters: read from the vehicle, compared with the parameter file."""
