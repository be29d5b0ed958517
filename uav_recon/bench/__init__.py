"""Benchmarks. They are composition roots like uav_recon/app."""
