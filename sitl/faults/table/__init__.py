"""The scenario table of the fault campaign."""
