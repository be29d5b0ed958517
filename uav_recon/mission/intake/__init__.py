"""Intake of frames, map corrections and vehicle states."""
