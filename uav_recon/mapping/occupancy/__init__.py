"""The occupancy map: depth fusion, free-space carving, distance field, snapshots."""
