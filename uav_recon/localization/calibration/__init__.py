"""Calibration in flight: the camera's mount and motion, its errors as estimated and kept.

The calibration by hand advises with the same filter: localization/hand_calibration.
"""
