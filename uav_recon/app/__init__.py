"""Composition roots: they build the objects of each process and connect them."""
