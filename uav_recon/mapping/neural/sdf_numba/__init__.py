"""The neural signed distance field that learns in flight (numba kernels)."""
