"""Checks on the evidence of a fault flight."""
