"""The fault campaign's part of the outside world: what goes wrong, when, and whether the flight bore it."""
