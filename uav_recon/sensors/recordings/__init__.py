"""Recordings of the world: folders and files with depth, colour, poses and inertial samples."""
