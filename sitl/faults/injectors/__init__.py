"""Fault injectors, one module for each part of the system that fails."""
