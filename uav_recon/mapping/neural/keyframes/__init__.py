"""Keyframes of the mapper: validation, buffer, pose refinement, ray sampling."""
