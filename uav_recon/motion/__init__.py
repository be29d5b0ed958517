"""Paths to trajectories: smooth, under limits, from rest to rest in known-free space; braking; the check of what is left."""

from uav_recon.motion.motion_planner import MotionPlanner

__all__ = ["MotionPlanner"]
