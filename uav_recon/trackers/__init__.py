"""Tracking engines of others beside the camera stream, each in a process of its own."""
