"""Cameras behind one protocol: RealSense, external camera stream, recorded flight."""
