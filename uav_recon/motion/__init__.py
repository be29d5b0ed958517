"""Motion planning: smooth trajectories within limits, braking, and clearance checks."""

from uav_recon.motion.motion_planner import MotionPlanner

__all__ = ["MotionPlanner"]
