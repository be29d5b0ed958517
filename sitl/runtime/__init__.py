"""Runtime support of the simulator: forks, worker pool, serial line, array cache, numba."""
