"""Fault injectors: what is made to fail, and when."""
