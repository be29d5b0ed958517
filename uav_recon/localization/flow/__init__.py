"""Motion of the body from optical flow and the range below."""
