"""Benchmarks: composition roots like run.py."""
