"""Composition roots of the fault campaign: the flights, their processes and their evidence."""
