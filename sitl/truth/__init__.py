"""Ground truth: visibility, clearance, line of sight, reference times."""
