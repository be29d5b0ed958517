"""Embedded RGB-D-inertial SLAM: poses from depth, colour and gyro."""
