"""Cameras behind one protocol: RealSense, any outside stream, a recording."""
