"""Survey: views, their keyframes, and what ends the survey."""
