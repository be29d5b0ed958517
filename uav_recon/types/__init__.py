"""Frozen values that cross a boundary: numpy only, arrays read-only, stamped at the source."""
