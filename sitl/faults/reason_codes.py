"""Codes of the product's reasons that checks and limits use, as plain strings.

The product's own code is not imported.
"""

from __future__ import annotations

NO_POSE = "no-pose"
POSE_STALE = "pose-stale"
MISSION_SILENT = "mission-silent"
MISSION_STALE = "mission-stale"
NO_DEPTH = "no-depth"
DEPTH_STALE = "depth-stale"
DEPTH_NOT_BELIEVED = "depth-not-believed"
ODOMETRY_DRIFT = "odometry-drift"
SURFACES_MOVED = "surfaces-moved"
SURFACES_GONE = "surfaces-gone"
SOURCE_EXCLUDED = "source-excluded"
NO_IMU = ("no-imu", "autopilot-gyro")  # the second while the autopilot's gyro takes its place
IMU_FROZEN = ("imu-frozen", "accelerometer-frozen", "autopilot-gyro")
ACCELEROMETER_WRONG = ("accelerometer-rejected", "imu-disagrees")
GYRO_WRONG = ("gyro-rejected",)
REDUCED_SPEED = "reduced-speed"
ESTIMATE_POSITION = "estimate-position"
ESTIMATE_VELOCITY = "estimate-velocity"
ESTIMATE_HEADING = "estimate-heading"
OFF_HEIGHT = "off-height"
INTRUDER_OWN_ID = "intruder-own-id"
INTRUDER_HEARTBEAT = "intruder-heartbeat"
INTRUDER_MAVLINK1 = "intruder-mavlink1"
INTRUDER_COMMANDS = "intruder-commands"
INTRUDER_STATE = "intruder-state"
TWO_AUTOPILOTS = "two-autopilots"
MODE_CHANGED = "mode-changed"
AUTOPILOT_LANDS = "autopilot-lands"
CONTROL_RELEASED = "control-released"
LANDING_NOT_ENDING = "landing-not-ending"
ARMING_GIVEN_UP = "arming-given-up"
PARAMETER_CHANGED = "parameter-changed"
OPERATOR_LAND = "operator-land"
MISSION_LAND = "mission-land"
OPERATOR_SILENT = "operator-silent"
OPERATOR_LOST_RETURNING = "operator-lost-returning"
FRONTIERS_TOO_NARROW = "frontiers-too-narrow"
FRONTIERS_NOT_REACHABLE = "frontiers-not-reachable"

INTRUDERS = (INTRUDER_OWN_ID, INTRUDER_HEARTBEAT, INTRUDER_MAVLINK1, INTRUDER_COMMANDS, INTRUDER_STATE)
DRIFT = (ODOMETRY_DRIFT, SURFACES_MOVED, SURFACES_GONE)  # what depth may say against the pose
AXES = ("axes-gravity", "axes-gyro", "axes-force", "axes-depth", "axes-attitude")
BATTERY = ("battery-takeoff", "battery-land", "battery-unknown", "battery-rate-unknown", "battery-return")
NO_OPERATOR = (OPERATOR_SILENT, OPERATOR_LOST_RETURNING)
CONTROL_LOST = (CONTROL_RELEASED, AUTOPILOT_LANDS)
# What a reason for a landing is: a refusal, a stranger or a slow link is none; whose the vehicle is by then is one too.
LANDING = (
    *CONTROL_LOST, *DRIFT, *AXES, OPERATOR_LAND, MISSION_LAND, "stop-requested", NO_POSE, MISSION_SILENT, NO_DEPTH,
    DEPTH_NOT_BELIEVED,
    TWO_AUTOPILOTS, ARMING_GIVEN_UP, PARAMETER_CHANGED, "poses-disagree", "few-poses", "imu-disagrees", "refused-too-long",
    "many-refusals", "held-too-long", "odometry-restarted", "outside-fence-too-long", "retreat-blocked", "evasion-blocked",
    "no-room-to-evade", "takeoff-given-up", "arming-withdrawn", "armed-late", "armed-by-other", "disarmed-in-flight",
    "disarmed-before-takeoff", "land-requested", ESTIMATE_POSITION, ESTIMATE_VELOCITY, ESTIMATE_HEADING, OFF_HEIGHT,
)  # fmt: skip
