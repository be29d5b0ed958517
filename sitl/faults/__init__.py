"""Fault campaign: fault injectors, onset conditions and checks of the flights."""
