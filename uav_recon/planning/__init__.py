"""The view planner: pure functions from frozen inputs to a path of views."""
