"""Benchmarks that need a scene or a simulated vehicle: mapper, SLAM, setpoints.

They are composition roots like sitl/apps.
"""
