"""Pure kernels shared by many stages: grids, ray traversal, projection."""
