"""Sequence: the phases of a flight, from the first connection to the motors' stop."""
