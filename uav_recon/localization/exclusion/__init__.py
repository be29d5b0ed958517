"""Fault detection and exclusion of the pose source: its motion against that of the view."""
