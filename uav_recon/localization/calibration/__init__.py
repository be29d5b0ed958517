"""Calibration: the camera's mount and motion, and its errors as estimated and kept."""
