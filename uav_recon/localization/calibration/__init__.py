"""Calibration in flight: the camera's mount and motion, its errors as estimated and kept.

The calibration by hand uses the same filter: localization/hand_calibration.
"""
