"""The mission's logs: phases and counts, perception, speed limits."""
