"""Localization: pose sources, and the filter that fuses them into smooth odometry."""
