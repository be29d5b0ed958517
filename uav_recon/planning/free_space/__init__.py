"""Space the vehicle may fly in: flyable space, reachability, clearance boxes."""
