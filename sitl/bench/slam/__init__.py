"""Benchmark of the embedded SLAM on rendered sequences with true poses."""
