"""Surface extraction from the field, and the uncertainty of the surface."""
