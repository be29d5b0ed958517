"""Frontiers and the best view of each."""
