"""Frozen values that cross boundaries: numpy only, read-only arrays, stamped at the source."""
