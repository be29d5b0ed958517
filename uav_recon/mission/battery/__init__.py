"""Battery: gauge, reserve for the way home, and policy (hazard E5)."""
