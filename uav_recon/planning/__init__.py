"""Where to look next: pure functions from frozen inputs to a path of views."""
