"""Consistency: depth frames against earlier views, and sensors against poses."""
