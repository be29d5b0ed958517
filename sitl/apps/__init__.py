"""Composition roots of the simulator: sim, sweep, lockstep, simulator process."""
