"""Set-up of a mission: its stages, channels and parameters."""
