"""The report of the fault campaign."""
