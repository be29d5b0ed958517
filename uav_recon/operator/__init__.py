"""Operator interface: a local socket at the pilot, and its clients."""
