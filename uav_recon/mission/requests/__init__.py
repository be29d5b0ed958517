"""Requests to the mission, the operator's commands, and the operator watchdog."""
