"""Signed distance field trained in flight (numba kernels)."""
