"""The planner benchmark: timing, tours, paths and views against oracles."""
