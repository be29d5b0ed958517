"""Map representations: occupancy voxels, distance field, keyframes and the neural surface."""
