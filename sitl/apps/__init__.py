"""Composition roots of the simulator: sim, sweep, lockstep, the world process."""
