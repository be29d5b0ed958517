"""Benchmarks of the product alone, on recorded streams.

They are composition roots like uav_recon/app. Benchmarks that need a scene or a simulated vehicle are in sitl/bench.
"""
