"""Process and memory tools of the simulator: forks, worker pool, caches, serial line."""
