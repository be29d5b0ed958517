"""The flown trajectory: its track, execution, pending views and planning."""
