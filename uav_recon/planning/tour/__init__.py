"""Which tasks are flown to, and in which order."""
