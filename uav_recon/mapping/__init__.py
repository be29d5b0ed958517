"""What is known of the room: voxels, distance field, keyframes, and the neural surface."""
