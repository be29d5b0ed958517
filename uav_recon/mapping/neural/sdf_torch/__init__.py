"""Signed distance field trained by `refine` (torch)."""
