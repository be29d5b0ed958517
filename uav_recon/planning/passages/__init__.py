"""Narrow passages: openings that are wide enough, but too narrow for the voxels of the map."""
