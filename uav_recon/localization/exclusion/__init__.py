"""Fault detection, isolation and exclusion of the pose source: its motion against that of the view."""
