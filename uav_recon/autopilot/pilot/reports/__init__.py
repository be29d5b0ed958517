"""Reports: what the pilot tells people at a ground station, and the other processes."""
