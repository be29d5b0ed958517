"""Uncertain surface, and the best views of it."""
