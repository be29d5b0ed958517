"""The neural signed distance field of `refine` (torch)."""
