"""Codes of the reasons that a flight gives, each on one line with its texts.

This is the table of messages.
"""

from __future__ import annotations

import string
from enum import Enum

Value = float | int | str


def _digits(*templates: str) -> tuple[int | None, ...]:
    """Decimals by index of the value; the last template that shows a value decides."""
    found: dict[int, int | None] = {}
    for template in templates:
        for _, name, spec, _ in string.Formatter().parse(template):
            if name is not None:
                places = (spec or "").rpartition(".")[2]
                fixed = int(places[:-1]) if places.endswith(("f", "%")) else None
                found[int(name)] = fixed + 2 if fixed is not None and places.endswith("%") else fixed
    return tuple(found.get(n) for n in range(max(found, default=-1) + 1))


class ReasonCode(str, Enum):
    """A reason's code. Programs compare codes; people read the texts.

    short: for a STATUSTEXT, at most 50 bytes of ASCII. long: for logs and screens, the same where it says no more. Both are
    templates (``str.format``) of the values by their index. example: typical largest values. digits: by index, the decimals
    that the texts show; None for values that are not rounded.
    """

    short: str
    long: str
    example: tuple[Value, ...]
    digits: tuple[int | None, ...]

    def __new__(cls, value: str, short: str, long: str = "", example: tuple[Value, ...] = ()) -> ReasonCode:
        """Make a member from a line of the table."""
        code = str.__new__(cls, value)
        code._value_, code.short, code.long, code.example = value, short, long or short, example
        code.digits = _digits(code.short, code.long)
        return code

    # --- guard: why a setpoint is not cleared ------------------------------------------------------------------------
    SETPOINT_NOT_FINITE = "setpoint-not-finite", "setpoint not finite"
    NO_SETPOINT_YET = "no-setpoint-yet", "no setpoint cleared yet"
    POSE_RESET = "pose-reset", "pose was reset"
    POSE_STALE = "pose-stale", "pose is stale"
    MISSION_STALE = "mission-stale", "mission is silent"
    DEPTH_STALE = "depth-stale", "depth is stale"
    TRAJECTORY_MAP_EPOCH = (
        "trajectory-map-epoch", "map epoch: trajectory {0:d}, pose {1:d}", "trajectory is of map epoch {0:d}, pose of {1:d}",
        (999, 999),
    )  # fmt: skip
    SPEED_LIMIT = "speed-limit", "speed {0:.2f} m/s above limit", "", (12.34,)
    ACCELERATION_LIMIT = (
        "acceleration-limit", "accel. {0:.2f} m/s2 above limit", "acceleration {0:.2f} m/s² above limit", (123.45,),
    )  # fmt: skip
    YAW_RATE_LIMIT = "yaw-rate-limit", "yaw rate {0:.2f} rad/s above limit", "", (12.34,)
    OUTSIDE_FENCE = "outside-fence", "outside fence at {0:.2f} {1:.2f} {2:.2f} m", "", (-12.34, -12.34, 12.34)
    NOT_KNOWN_FREE = "not-known-free", "not known free at {0:.2f} {1:.2f} {2:.2f} m", "", (-12.34, -12.34, 2.34)
    NOT_SEEN_RECENTLY = "not-seen-recently", "not seen lately at {0:.2f} {1:.2f} {2:.2f} m", "", (-12.34, -12.34, 2.34)
    NO_FREE_SPACE = "no-free-space", "no known-free space received"
    FREE_SPACE_MAP_EPOCH = (
        "free-space-map-epoch", "map epoch: free space {0:d}, pose {1:d}",
        "known-free space is of map epoch {0:d}, pose of {1:d}",
        (999, 999),
    )  # fmt: skip
    OBSTACLE_NEAR = "obstacle-near", "obstacle at {0:.2f} m, speed {1:.2f} m/s", "", (-12.34, 12.34)
    SPEED_OUT_OF_VIEW = "speed-out-of-view", "speed {0:.2f} m/s outside the camera view", "", (12.34,)
    POSITION_STEP = "position-step", "setpoint jump of {0:.2f} m", "", (12.34,)
    VELOCITY_STEP = "velocity-step", "velocity jump of {0:.2f} m/s", "", (12.34,)
    HEADING_STEP = "heading-step", "heading jump of {0:.0f} degrees", "", (180.0,)
    POSITION_OFF_VELOCITY = "position-off-velocity", "setpoint {0:.2f} m off its velocity", "", (12.34,)
    REFUSED = "refused", "refused"  # details: why

    # --- guard: why the vehicle may not climb ------------------------------------------------------------------------
    TAKEOFF_COLUMN_NOT_SEEN = (
        "takeoff-column-not-seen", "no depth of the column", "no depth frame has confirmed the take-off column",
    )  # fmt: skip
    TAKEOFF_COLUMN_OUTSIDE_FENCE = (
        "takeoff-column-outside-fence", "column outside the fence", "the take-off column is not inside the fence",
    )  # fmt: skip
    TAKEOFF_COLUMN_NOT_FREE = "takeoff-column-not-free", "column not known free", "the take-off column is not known free"
    TAKEOFF_VIEW_BLOCKED = (
        "takeoff-view-blocked", "camera blocked at {0:.2f} m (min. {1:.2f})",
        "something stands {0:.2f} m before the camera; it must be free for {1:.2f} m", (12.34, 12.34),
    )  # fmt: skip
    TAKEOFF_VIEW_BLANK = (
        "takeoff-view-blank", "{0:.0%} of the view blank (max. {1:.0%})",
        "{0:.0%} of the view above the horizon has no depth, the limit is {1:.0%}: uncover the camera, light the room, or turn "
        "the vehicle towards something within 6 m", (1.0, 1.0),
    )  # fmt: skip
    TAKEOFF_REFUSED = "takeoff-refused", "take-off refused"  # details: why

    # --- pose gate: why a pose is not fed ----------------------------------------------------------------------------
    POSE_AGE = "pose-age", "pose is {0:.2f} s old", "", (-123.45,)
    POSE_MALFORMED = "pose-malformed", "pose is malformed"
    POSE_OUT_OF_RANGE = "pose-out-of-range", "pose is out of range"
    POSE_NO_QUALITY = "pose-no-quality", "pose has no quality"
    POSE_REPEATED = "pose-repeated", "pose is repeated or older than the one before"
    POSE_ON_TRIAL = "pose-on-trial", "pose is on trial after a loss"
    POSE_JUMP = "pose-jump", "pose jump of {0:.2f} m", "", (123.45,)
    POSE_SPEED = "pose-speed", "pose moved {0:.2f} m in {1:.2f} s", "", (123.45, 12.34)
    POSE_TURN = "pose-turn", "pose turn of {0:.0f} degrees", "", (180.0,)

    # --- failsafe ----------------------------------------------------------------------------------------------------
    NO_POSE = "no-pose", "no pose for {0:.1f} s", "", (123.4,)
    MISSION_SILENT = "mission-silent", "mission silent for {0:.1f} s", "", (123.4,)
    NO_DEPTH = "no-depth", "no depth for {0:.1f} s", "", (123.4,)
    DEPTH_NOT_BELIEVED = (
        "depth-not-believed", "depth not believed for {0:.1f} s", "depth frames come, none is believed for {0:.1f} s", (123.4,),
    )  # fmt: skip
    REFUSED_TOO_LONG = "refused-too-long", "refused for {0:.1f} s", "", (123.4,)
    MANY_REFUSALS = "many-refusals", "{0:d} refusals in a second", "", (3,)
    OUTSIDE_FENCE_TOO_LONG = "outside-fence-too-long", "outside the fence for {0:.0f} s", "", (10.0,)
    HELD_TOO_LONG = "held-too-long", "held for {0:.0f} s", "", (120.0,)  # a detail of why it was held
    CLOCK_UNCERTAIN = "clock-uncertain", "autopilot clock uncertain"  # a detail

    # --- odometry and depth ------------------------------------------------------------------------------------------
    POSES_DISAGREE = "poses-disagree", "poses disagree for {0:.1f} s", "", (123.4,)
    PLACE_UNSURE = "place-unsure", "place uncertain by {0:.2f} m", "the place is uncertain by {0:.2f} m", (1.23,)
    SOURCE_EXCLUDED = (
        "source-excluded", "pose source contradicts view, not used",
        "the view and the inertial sensors contradict the pose source: it is not used",
    )  # fmt: skip
    FEW_POSES = "few-poses", "{0:.0f} poses a second", "", (30.0,)
    NO_IMU = "no-imu", "no inertial samples"
    IMU_FROZEN = "imu-frozen", "IMU values repeat, not used", "the values of the IMU repeat: it is not used"
    ACCELEROMETER_FROZEN = (
        "accelerometer-frozen", "accelerometer repeats, not used", "the values of the accelerometer repeat: it is not used",
    )  # fmt: skip
    ACCELEROMETER_REJECTED = (
        "accelerometer-rejected", "accelerometer contradicts poses, not used",
        "the accelerometer contradicts the poses: it is not used",
    )  # fmt: skip
    GYRO_REJECTED = "gyro-rejected", "gyro contradicts poses, not used", "the gyro contradicts the poses: the IMU is not used"
    IMU_DISAGREES = "imu-disagrees", "poses and IMU disagree, NIS {0:.0f} for 6", "", (150.0,)
    ODOMETRY_DEGRADED = "odometry-degraded", "odometry degraded"  # where its source gives no reason
    REDUCED_SPEED = "reduced-speed", "slow", "reduced speed"  # details: why
    FULL_SPEED = "full-speed", "full speed again"
    ODOMETRY_DRIFT = "odometry-drift", "odometry drift {0:.3f} m/s", "", (1.234,)
    ODOMETRY_CORRECTED = (
        "odometry-corrected", "odometry corrected by {0:.2f} m",
        "the pose source drifts: odometry is corrected by {0:.2f} ± {2:.2f} m and {1:.1f} degrees", (12.34, -180.0, 12.34),
    )  # fmt: skip
    SURFACES_MOVED = (
        "surfaces-moved", "surfaces {0:.2f} m off those {1:.0f} s ago",
        "surfaces are {0:.2f} m off where they were {1:.0f} s ago",
        (12.34, 120.0),
    )  # fmt: skip
    SURFACES_GONE = (
        "surfaces-gone", "surfaces gone, {0:.0%} of those {1:.0f} s ago", "{0:.0%} of the surfaces seen {1:.0f} s ago are gone",
        (1.0, 120.0),
    )  # fmt: skip
    DEPTH_FRAME_EMPTY = (
        "depth-frame-empty", "depth frame: returns in {0:.0%}", "depth frame: returns in {0:.0%} of the pixels", (1.0,),
    )  # fmt: skip
    DEPTH_FRAME_NOISE = (
        "depth-frame-noise", "depth frame: {0:.0%} isolated pixels", "depth frame: {0:.0%} of the pixels are isolated", (1.0,),
    )  # fmt: skip
    DEPTH_FRAME_REPEATS = "depth-frame-repeats", "depth frame: repeats", "depth frame: the image before it once more"
    DEPTH_FRAME_FROZEN = "depth-frame-frozen", "depth frame: frozen", "depth frame: the same image after the camera moved"
    DEPTH_FRAME_SHIFTED = "depth-frame-shifted", "depth frame: shifted image"
    DEPTH_FRAME_CONTRADICTS = (
        "depth-frame-contradicts", "depth frame: contradicts earlier ones", "depth frame: contradicts what was seen before",
    )  # fmt: skip
    DEPTH_FRAME_UNCONFIRMED = (
        "depth-frame-unconfirmed", "depth frame: not confirmed yet", "depth frame: not yet confirmed after a wrong one",
    )  # fmt: skip
    DEPTH_FRAME_STAMP = "depth-frame-stamp", "depth frame: wrong time stamp", "depth frame: too old, too new, or out of order"
    DEPTH_FRAME_UNPLACED = "depth-frame-unplaced", "depth frame: no pose", "depth frame: no pose at its stamp"
    DEPTH_FRAME_UNSURE = "depth-frame-unsure", "depth frame: place uncertain", "depth frame: not mapped, the place is uncertain"
    PAD_AWAITED = (
        "pad-awaited", "waiting for rest on the pad",
        "no odometry yet: waiting until the pose source has been at rest on the pad for {0:.1f} s", (0.5,),
    )  # fmt: skip
    PAD_IS_ORIGIN = (
        "pad-is-origin", "pad {0:.1f} m, {1:.0f} deg off source's origin",
        "the take-off pad is {0:.2f} m and {1:.0f} degrees off the pose source's origin: the world begins at the pad",
        (1234.5, -180.0),
    )  # fmt: skip
    AXES_GRAVITY = (
        "axes-gravity", "axes: IMU and poses {0:.0f} deg apart",
        "wrong axes: at rest the IMU's vertical is {0:.0f} degrees off that of the poses", (180.0,),
    )  # fmt: skip
    AXES_GYRO = (
        "axes-gyro", "axes: gyro xyz turns as poses {0}", "wrong axes: the gyro turns as the poses if its x y z are {0}",
        ("-x -y -z",),
    )  # fmt: skip
    AXES_FORCE = (
        "axes-force", "axes: poses xyz move as IMU {0}",
        "wrong axes: the poses move as the accelerometer says if their x y z are {0}", ("-x -y -z",),
    )  # fmt: skip
    AXES_DEPTH = (
        "axes-depth", "axes: depth fits poses as {0}", "wrong axes: depth fits the motion of the poses if their x y z are {0}",
        ("-x -y -z",),
    )  # fmt: skip
    AXES_ATTITUDE = (
        "axes-attitude", "axes: autopilot and poses {0:.0f} deg apart",
        "wrong axes: the autopilot's vertical is {0:.0f} degrees off that of the poses", (180.0,),
    )  # fmt: skip
    CALIBRATION_KEPT = (
        "calibration-kept", "camera errors of an earlier flight: {0:d}",
        "the camera's errors begin from an earlier flight: {0:d} known", (14,),
    )  # fmt: skip
    CALIBRATION_IGNORED = (
        "calibration-ignored", "kept camera errors not used: {0}", "the kept errors of the camera are not used: {0}",
        ("no calibration file",),
    )  # fmt: skip
    EARLIER_MAP_SEARCHED = (
        "earlier-map-searched", "map of an earlier flight: not found yet",
        "this flight was not found in the map of an earlier one yet, which has {0:d} keyframes", (200,),
    )  # fmt: skip
    EARLIER_MAP_FOUND = (
        "earlier-map-found", "began {0:.2f} {1:.2f} {2:.2f} m {3:.0f} deg",
        "found in the map of an earlier flight: this one began at {0:.2f}, {1:.2f}, {2:.2f} m from its start, turned by "
        "{3:.1f} degrees", (-1.23, -1.23, -0.12, -123.4),
    )  # fmt: skip
    EARLIER_MAP_IGNORED = (
        "earlier-map-ignored", "map of an earlier flight: {0}", "the map of an earlier flight is not used: {0}",
        ("not the map of a flight",),
    )  # fmt: skip
    ODOMETRY_RESTARTED = "odometry-restarted", "odometry restarted, the map does not fit it"
    POSE_SOURCE_RESET = "pose-source-reset", "pose source was reset, holding"

    # --- the autopilot's estimate -------------------------------------------------------------------------------------
    ESTIMATE_POSITION = (
        "estimate-position", "autopilot position {0:.2f} m off the poses",
        "the autopilot's position is {0:.2f} m off the poses that it is fed", (123.45,),
    )  # fmt: skip
    ESTIMATE_VELOCITY = (
        "estimate-velocity", "autopilot velocity {0:.2f} m/s off the poses",
        "the autopilot's velocity is {0:.2f} m/s off the poses that it is fed", (12.34,),
    )  # fmt: skip
    ESTIMATE_HEADING = (
        "estimate-heading", "autopilot heading {0:.0f} degrees off the poses",
        "the autopilot's heading is {0:.0f} degrees off the poses that it is fed", (180.0,),
    )  # fmt: skip
    OFF_HEIGHT = "off-height", "{0:.2f} m off the setpoints' height", "", (12.34,)

    # --- obstacles, retreat ------------------------------------------------------------------------------------------
    NEW_OBSTACLE = "new-obstacle", "new obstacle at {0:.2f} m", "", (12.34,)
    OFF_PATH = "off-path", "off the path by {0:.2f} m", "", (12.34,)
    NO_ROOM_TO_EVADE = "no-room-to-evade", "no free space to evade into"
    EVASION_BLOCKED = "evasion-blocked", "evasion blocked"  # details: why
    RETREAT_BLOCKED = "retreat-blocked", "retreat blocked"  # details: why

    # --- trajectories received ---------------------------------------------------------------------------------------
    TRAJECTORY_MALFORMED = "trajectory-malformed", "trajectory is malformed"
    TRAJECTORY_NO_TIME_AXIS = "trajectory-no-time-axis", "trajectory has no time axis"
    TRAJECTORY_NOT_FINITE = "trajectory-not-finite", "trajectory is not finite"
    TRAJECTORY_OUT_OF_RANGE = "trajectory-out-of-range", "trajectory is out of range"
    TRAJECTORY_NOT_AT_REST = "trajectory-not-at-rest", "trajectory does not end at rest"

    # --- before arming -----------------------------------------------------------------------------------------------
    LINK_ERROR = "link-error", "link: {0}", "", ("No such device or address",)
    NO_HEARTBEAT = "no-heartbeat", "no heartbeat from the autopilot"
    WRONG_FIRMWARE = (
        "wrong-firmware", "autopilot is not {0} (MAV_AUTOPILOT {1:d})", "the autopilot is not {0} (MAV_AUTOPILOT {1:d})",
        ("ArduPilot", 255),
    )  # fmt: skip
    OUR_ID_IN_USE = "our-id-in-use", "another companion uses our id"
    FIRMWARE_UNKNOWN = "firmware-unknown", "firmware version unknown"
    FIRMWARE_TOO_OLD = "firmware-too-old", "firmware {0} {1} is older than {2}", "", ("ArduPilot", "4.10.10", "4.10.10")
    FIRMWARE_TOO_NEW = (
        "firmware-too-new", "firmware {0} {1} untested, use < {2}",
        "firmware {0} {1} is not tested: a version before {2} is needed",
        ("ArduPilot", "4.10.10", "4.10.10"),
    )  # fmt: skip
    CLOCKS_NOT_SYNCHRONISED = "clocks-not-synchronised", "clocks not synchronised yet"
    NO_POSE_FED = "no-pose-fed", "no pose to feed"
    ESTIMATOR_NOT_FOLLOWING = "estimator-not-following", "estimator does not follow the poses yet"
    NO_ORIGIN = "no-origin", "no origin yet"
    PREARM_FAILED = "prearm-failed", "pre-arm checks fail"  # details: the autopilot's text
    WAITING_FOR_TIMESYNC = (
        "waiting-for-timesync", "bad link, waiting for PX4 TIMESYNC ({0:d}/{1:d})",
        "link delays or duplicates frames, waiting for PX4 TIMESYNC ({0:d}/{1:d})", (499, 500),
    )  # fmt: skip
    NO_AUTOPILOT_PARAMETERS = "no-autopilot-parameters", "no autopilot to read parameters from"
    READING_PARAMETERS = "reading-parameters", "reading parameters, {0:d} of {1:d}", "", (999, 999)
    PARAMETER_DIFFERS = (
        "parameter-differs", "param {0} {1:.7g}, not {2}",
        "parameter {0} is {1:.7g}, wanted {2} ({3:d} differ): see uav-recon params diff",
        ("COM_RC_OVERRIDE", 12345.67, "1.5 m/s", 99),
    )  # fmt: skip
    PARAMETER_NOT_REPORTED = (
        "parameter-not-reported", "param {0} not reported, needs {1}",
        "parameter {0} is not reported by the autopilot, wanted {1} ({2:d} differ): see uav-recon params diff",
        ("COM_RC_OVERRIDE", "1.5 m/s", 99),
    )  # fmt: skip
    PARAMETER_CHANGED = "parameter-changed", "in flight", "changed in flight"  # details: which
    STARTING = "starting", "starting"

    # --- arming, take-off --------------------------------------------------------------------------------------------
    ARMING_GIVEN_UP = "arming-given-up", "arming given up"  # details: why
    ARMING_WITHDRAWN = "arming-withdrawn", "arming withdrawn"
    MODE_UNCHANGED = "mode-unchanged", "mode stays {0}", "", ("STABILIZED",)
    MOTORS_STAY_OFF = "motors-stay-off", "motors stay off"
    TAKEOFF_GIVEN_UP = "takeoff-given-up", "take-off given up"  # details: why
    DISARMED_BEFORE_TAKEOFF = "disarmed-before-takeoff", "disarmed before it flew"
    TILTED = "tilted", "tilted by {0:.0f} degrees", "tilted by {0:.0f} degrees on the ground", (180.0,)
    CLIMB_TOO_SLOW = "climb-too-slow", "climbed {0:.2f} m in {1:.0f} s", "climbed only {0:.2f} m in {1:.0f} s", (12.34, 12.0)
    AUTOPILOT_TEXT = "autopilot-text", "{0}", "", ("PreArm: Fence requires position",)  # a detail

    # --- control and landing -----------------------------------------------------------------------------------------
    CONTROL_RELEASED = "control-released", "CTRL RELEASED", "control released"  # details: why
    FAILSAFE_LANDS = "failsafe-lands", "failsafe lands", "heartbeats stop, so the autopilot's failsafe lands"  # a detail
    MODE_STILL_OURS = "mode-still-ours", "mode still ours", "the autopilot is still in our mode"
    MODE_CHANGED = "mode-changed", "mode changed to {0}", "", ("STABILIZED",)
    ARMED_BY_OTHER = "armed-by-other", "armed by another"
    ARMED_LATE = "armed-late", "armed after the request was withdrawn"
    DISARMED_IN_FLIGHT = "disarmed-in-flight", "disarmed in flight"
    AUTOPILOT_RESTARTED = "autopilot-restarted", "autopilot restarted", "the autopilot restarted in flight"
    AUTOPILOT_SILENT = "autopilot-silent", "autopilot silent", "the autopilot is silent"
    AUTOPILOT_LANDS = "autopilot-lands", "autopilot lands", "the autopilot lands"  # details: its text
    CONTROL_RETURNED = (
        "control-returned", "no pilot in {0}, choose another mode", "nobody flies in {0}: choose another mode", ("STABILIZED",),
    )  # fmt: skip
    LAND_NOT_ACCEPTED = "land-not-accepted", "no LAND in {0:.0f} s", "no LAND mode within {0:.0f} s", (5.0,)
    LAND_REQUESTED = "land-requested", "mode ours again, LAND requested", "autopilot in our mode again, LAND requested"
    LANDING_NOT_ENDING = "landing-not-ending", "landing does not end, switch the motors off"
    STOP_REQUESTED = "stop-requested", "asked to end"
    OPERATOR_LAND = "operator-land", "operator asked to land", "the operator asked to land"
    MISSION_LAND = "mission-land", "mission asks to land", "the mission asks to land"

    # --- camera ------------------------------------------------------------------------------------------------------
    CAMERA_STREAMS = (
        "camera-streams", "camera streams: {0}", "camera streams: depth {0}, colour {1}, IMU {2}, USB {3}",
        ("424x240 at 30 Hz", "424x240 at 30 Hz", "200 Hz", "3.2"),
    )  # fmt: skip
    CAMERA_USB2 = (
        "camera-usb2", "camera on USB {0}", "the camera is on USB {0}: {1} frames a second, later than on USB 3; "
        "use a USB 3 port and cable", ("2.1", "15"),
    )  # fmt: skip
    CAMERA_FIRMWARE = (
        "camera-firmware", "camera firmware {0} is bad", "camera firmware {0} with SDK {1} is known to be bad: {2}; {3}",
        ("5.11.1.100", "2.59.1", "single depth frames are all zero", "update to 5.11.6.200 or later"),
    )  # fmt: skip
    CAMERA_WITHOUT_IMU = (
        "camera-without-imu", "camera has no IMU",
        "the camera offers no IMU: on JetPack 6 install an SDK with the RSUSB backend",
    )  # fmt: skip
    AUTOPILOT_GYRO = (
        "autopilot-gyro", "autopilot's gyro is used", "no working IMU of the camera: the autopilot's gyro takes its place",
    )  # fmt: skip
    CAMERA_CLOCK_BEHIND = (
        "camera-clock-behind", "camera {0} clock {1:.2f} s behind",
        "the clock of {0} is {1:.2f} s behind: its stamps are taken from their arrivals", ("depth", 0.8),
    )  # fmt: skip
    CAMERA_CLOCKS_APART = (
        "camera-clocks-apart", "camera clocks {2:.2f} s apart",
        "the stamps of {0} and {1} come from two clocks, {2:.2f} s apart: the delay between them is not known",
        ("depth", "gyro", 0.2),
    )  # fmt: skip
    CAMERA_DOMAINS = (
        "camera-domains", "camera stamps: {1}, {3}",
        "camera stamps: {0} by {1}, {2} by {3}: the delay between them is not known",
        ("depth", "system time", "gyro", "hardware clock"),
    )  # fmt: skip
    CAMERA_ARRIVAL_STAMPS = (
        "camera-arrival-stamps", "camera stamps are arrival times",
        "camera stamps are arrival times (system time), up to 50 ms late: install frame metadata or the RSUSB backend",
    )  # fmt: skip
    CAMERA_STAMPS_REFUSED = (
        "camera-stamps-refused", "camera {0} refused: no clock",
        "camera {0} refused: its stamps do not run with any clock; reconnect the camera", ("depth",),
    )  # fmt: skip
    CAMERA_EMITTER_OFF = (
        "camera-emitter-off", "camera emitter off", "the camera's infrared emitter is off: no depth on walls without texture",
    )  # fmt: skip
    CAMERA_RESTARTS = (
        "camera-restarts", "camera lost, restart {0:d} of {1:d}", "the camera is lost ({2}): restart {0:d} of {1:d}",
        (3, 3, "no frame for 1.5 s"),
    )  # fmt: skip
    EXPOSURE_LOCKED = (
        "exposure-locked", "exposure locked", "exposure and white balance of the colour camera are locked: {0:.0f}, {1:.0f} K",
        (156.0, 4600.0),
    )  # fmt: skip
    EXPOSURE_NOT_LOCKED = (
        "exposure-not-locked", "exposure not locked", "exposure stays automatic: {0}",
        ("the colour camera has no such control",),
    )  # fmt: skip

    # --- link --------------------------------------------------------------------------------------------------------
    AUTOPILOT_CHANGED = (
        "autopilot-changed", "other autopilot, uid {0}", "another autopilot: uid {0}, before it was {1}",
        ("0123456789abcdef", "0123456789abcdef"),
    )  # fmt: skip
    AUTOPILOT_NOT_CONFIGURED = (
        "autopilot-not-configured", "wrong autopilot, uid {0}", "wrong autopilot: uid {0}, link.autopilot_uid is {1}",
        ("0123456789abcdef", "0123456789abcdef"),
    )  # fmt: skip
    TWO_AUTOPILOTS = "two-autopilots", "two autopilots use one id"
    INTRUDER_OWN_ID = "intruder-own-id", "intruder uses our own id"
    INTRUDER_HEARTBEAT = (
        "intruder-heartbeat", "MAV_TYPE {0:d} sends with the autopilot's id",
        "another program sends heartbeats with the autopilot's id: MAV_TYPE {0:d}, MAV_AUTOPILOT {1:d}; it is ignored",
        (255, 255),
    )  # fmt: skip
    INTRUDER_MAVLINK1 = "intruder-mavlink1", "intruder sends MAVLink 1"
    INTRUDER_COMMANDS = (
        "intruder-commands", "intruder {0:d}/{1:d} commands us", "intruder: system {0:d}, component {1:d} commands us",
        (255, 255),
    )  # fmt: skip
    INTRUDER_STATE = (
        "intruder-state", "intruder {0:d}/{1:d} sends vehicle state",
        "intruder: system {0:d}, component {1:d} sends vehicle state",
        (255, 255),
    )  # fmt: skip
    LINK_SLOW = "link-slow", "slow link, round trip {0:.2f} s", "the link is slow: round trip {0:.2f} s", (12.34,)

    # --- battery -----------------------------------------------------------------------------------------------------
    BATTERY_TAKEOFF = "battery-takeoff", "battery at {0:.0f} %, take-off needs {1:.0f} %", "", (100.0, 100.0)
    BATTERY_LAND = "battery-land", "battery at {0:.0f} %, landing here", "", (100.0,)
    BATTERY_UNKNOWN = "battery-unknown", "battery unknown"
    BATTERY_RATE_UNKNOWN = (
        "battery-rate-unknown", "battery at {0:.0f} %, drain unknown", "battery at {0:.0f} %, and its drain is not known yet",
        (100.0,),
    )  # fmt: skip
    BATTERY_RETURN = (
        "battery-return", "battery at {0:.0f} %, return needs {2:.0f} %",
        "battery at {0:.0f} %: the way home of {1:.0f} m needs {2:.0f} %", (100.0, 1000.0, 100.0),
    )  # fmt: skip

    # --- operator ----------------------------------------------------------------------------------------------------
    OPERATOR_RETURN = "operator-return", "operator asked to return", "the operator asked to return"
    OPERATOR_MISSING = "operator-missing", "no operator, run uav-recon status --watch"
    OPERATOR_LOST = "operator-lost", "no operator for {0:.0f} s", "", (9999.0,)
    OPERATOR_LOST_RETURNING = "operator-lost-returning", "no operator for {0:.0f} s, returning", "", (9999.0,)
    OPERATOR_SILENT = "operator-silent", "no operator for {0:.0f} s, returns after {1:.0f} s", "", (10.0, 9999.0)
    OPERATOR_BACK = "operator-back", "the operator is back"
    CONTROL_HANDED_OVER = (
        "control-handed-over", "control was handed over", "control was handed over, restart uav-recon-pilot to take it again",
    )  # fmt: skip
    FLIGHT_OVER = "flight-over", "this flight is over", "this flight is over: restart the services for another one"
    NOT_READY = "not-ready", "not ready"  # details: why
    NOT_FLYING = "not-flying", "on the ground ({0}), cannot {1}", "on the ground ({0}): nothing to {1}", ("landed", "return")
    TAKING_OFF = "taking-off", "taking off", "about to take off: land, or ask again in flight"
    LANDING_IS_FINAL = "landing-is-final", "landing", "landing: this cannot be taken back"
    MISSION_CANNOT_RETURN = (
        "mission-cannot-return", "mission is silent, hold or land",
        "the mission is silent and cannot return home: hold or land",
    )  # fmt: skip
    MISSION_NOT_RUNNING = (
        "mission-not-running", "no mission running", "the mission is silent: is uav-recon-mission running, or has it finished?",
    )  # fmt: skip
    UNKNOWN_COMMAND = "unknown-command", "unknown command {0}", "unknown command {0}: use {1}", ("'restart everything'", "x")

    # --- mission -----------------------------------------------------------------------------------------------------
    MAP_RESTARTED = "map-restarted", "map epoch {0:d}, mapping again", "", (999,)
    PLANNER_SILENT = "planner-silent", "planner silent for {0:.0f} s", "the planner has not answered for {0:.0f} s", (120.0,)
    MAP_BLOCKS_PATH = "map-blocks-path", "map shows an obstacle on the path", "the map shows an obstacle on the path"
    PLAN_NOT_FLYABLE = "plan-not-flyable", "plan not flyable"  # details: why
    PLACE_UNSURE_OFTEN = "place-unsure-often", "the place became uncertain {0:d} times without a view", "", (99,)
    PLANS_FAILED = "plans-failed", "{0:d} plans in a row not flyable", "", (99,)  # details: why
    VIEWS_SPENT = "views-spent", "view budget of {0:d} spent", "", (9999,)
    TIME_SPENT = "time-spent", "flight time of {0:.0f} s spent", "", (9999.0,)
    FRONTIERS_IN_LAST_PLAN = "frontiers-in-last-plan", "{0:d} frontiers left in the last plan", "", (9999,)  # a detail
    RETURN_STOPPED = "return-stopped", "stopped {0:d} times on the way home", "", (99,)
    NO_WAY_BACK = "no-way-back", "no way back"  # details: why
    HELD_ON_WAY_HOME = "held-on-way-home", "held on the way home"
    LANDING_SITE_OCCUPIED = "landing-site-occupied", "landing site occupied at {0:.1f} {1:.1f} m", "", (-123.4, -123.4)
    ENDED_IN_PHASE = "ended-in-phase", "ended in phase {0}", "", ("take-off",)

    # --- motion and planning -----------------------------------------------------------------------------------------
    PATH_MAP_EPOCH = (
        "path-map-epoch", "map epoch: path {0:d}, map {1:d}", "path rejected: map epoch {0:d}, of the map {1:d}", (999, 999),
    )  # fmt: skip
    PATH_WITHOUT_VIEW = "path-without-view", "path without a view", "path rejected: it has no view"
    PATH_ENTRY_TOO_FAST = (
        "path-entry-too-fast", "too fast for the path", "path rejected: the present motion is too fast for it",
    )  # fmt: skip
    PATH_CLEARANCE = (
        "path-clearance", "clearance < {0:.2f} m at {1:.2f} {2:.2f} {3:.2f}",
        "path rejected: clearance below {0:.2f} m at ({1:.2f}, {2:.2f}, {3:.2f})", (0.35, -123.45, -123.45, 12.34),
    )  # fmt: skip
    NO_KNOWN_PATH = "no-known-path", "no known-free path leads there"
    NO_VIEWS_LEFT = "no-views-left", "no view is left in the budget"
    START_NOT_FREE = (
        "start-not-free", "no known-free path from here",
        "the vehicle is in space that is not known free, with no known-free path to where it may fly",
    )  # fmt: skip
    PLACES_LEFT_UNSEEN = "places-left-unseen", "{0:d} place(s) left unseen", "", (9999,)  # details: counts
    FRONTIERS_LEFT = "frontiers-left", "{0:d} frontiers left", "", (9999,)  # details: counts
    NO_FRONTIERS_LEFT = "no-frontiers-left", "no frontiers left"
    FRONTIERS_TOO_SMALL = "frontiers-too-small", "{0:d} too small", "", (9999,)
    FRONTIERS_VIEWED_WITHOUT_RESULT = "frontiers-viewed-without-result", "{0:d} viewed without result", "", (9999,)
    FRONTIERS_OUTSIDE_FENCE = "frontiers-outside-fence", "{0:d} outside the fence", "", (9999,)
    FRONTIERS_TOO_NARROW = "frontiers-too-narrow", "{0:d} too narrow", "", (9999,)
    FRONTIERS_TOO_FEW_CELLS = "frontiers-too-few-cells", "{0:d} with too few cells in view", "", (9999,)
    FRONTIERS_NOT_REACHABLE = "frontiers-not-reachable", "{0:d} not reachable", "", (9999,)
    FRONTIERS_OUT_OF_VIEW = "frontiers-out-of-view", "{0:d} out of the camera's view", "", (9999,)
    FRONTIERS_NOT_FLOWN_TO = "frontiers-not-flown-to", "{0:d} with a view that was not flown to", "", (9999,)
    PASSAGE_TOO_NARROW = (
        "passage-too-narrow", "opening {0:.2f} m wide < {1:.2f} m at {2:.1f} {3:.1f}",
        "an opening at ({2:.1f}, {3:.1f}) is too narrow: the map shows {0:.2f} m, {1:.2f} m are needed",
        (0.57, 0.57, -123.4, -123.4),
    )  # fmt: skip
    SURFACE_NOT_WORTH = "surface-not-worth", "{0:d} surface tasks not worth their flight", "", (9999,)
    VIEWS_BLIND = "views-blind", "{0:d} views do not show where the vehicle is", "", (9999,)


# wrong axes or signs of poses, camera or inertial sensor
AXES = frozenset(
    {ReasonCode.AXES_GRAVITY, ReasonCode.AXES_GYRO, ReasonCode.AXES_FORCE, ReasonCode.AXES_DEPTH, ReasonCode.AXES_ATTITUDE}
)
