"""Codes of the product's reasons that checks and limits use, as plain strings.

The product's own code is not imported.
"""

from __future__ import annotations

NO_POSE, POSE_STALE = "no-pose", "pose-stale"
MISSION_SILENT, MISSION_STALE = "mission-silent", "mission-stale"
NO_DEPTH, DEPTH_STALE = "no-depth", "depth-stale"
ODOMETRY_DRIFT, SURFACES_MOVED, SURFACES_GONE = "odometry-drift", "surfaces-moved", "surfaces-gone"
INTRUDER_OWN_ID, INTRUDER_MAVLINK1 = "intruder-own-id", "intruder-mavlink1"
INTRUDER_COMMANDS, INTRUDER_STATE = "intruder-commands", "intruder-state"
TWO_AUTOPILOTS, MODE_CHANGED, AUTOPILOT_LANDS = "two-autopilots", "mode-changed", "autopilot-lands"
CONTROL_RELEASED, LANDING_NOT_ENDING = "control-released", "landing-not-ending"
ARMING_GIVEN_UP, PARAMETER_CHANGED = "arming-given-up", "parameter-changed"
OPERATOR_LAND, MISSION_LAND = "operator-land", "mission-land"
OPERATOR_SILENT, OPERATOR_LOST_RETURNING = "operator-silent", "operator-lost-returning"
FRONTIERS_TOO_NARROW, FRONTIERS_NOT_REACHABLE = "frontiers-too-narrow", "frontiers-not-reachable"

INTRUDERS = (INTRUDER_OWN_ID, INTRUDER_MAVLINK1, INTRUDER_COMMANDS, INTRUDER_STATE)
DRIFT = (ODOMETRY_DRIFT, SURFACES_MOVED, SURFACES_GONE)  # what depth may say against the pose
BATTERY = ("battery-takeoff", "battery-land", "battery-unknown", "battery-rate-unknown", "battery-return")
NO_OPERATOR = (OPERATOR_SILENT, OPERATOR_LOST_RETURNING)
CONTROL_LOST = (CONTROL_RELEASED, AUTOPILOT_LANDS)
# What a reason for a landing is: a refusal, a stranger or a slow link is none; whose the vehicle is by then is one too.
LANDING = (
    *CONTROL_LOST, *DRIFT, OPERATOR_LAND, MISSION_LAND, "stop-requested", NO_POSE, MISSION_SILENT, NO_DEPTH, TWO_AUTOPILOTS,
    ARMING_GIVEN_UP, PARAMETER_CHANGED, "poses-disagree", "few-poses", "imu-disagrees", "refused-too-long", "many-refusals",
    "held-too-long", "odometry-restarted", "outside-fence-too-long", "retreat-blocked", "evasion-blocked", "no-room-to-evade",
    "takeoff-given-up", "arming-withdrawn", "armed-late", "armed-by-other", "disarmed-in-flight", "disarmed-before-takeoff",
    "land-requested",
)  # fmt: skip
