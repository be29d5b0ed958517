"""Simulated EKF: IMU integration corrected by late poses, with gates, timeouts and resets.

Frames: local NED (the frame of the input poses), body FRD. Times: seconds of the autopilot's clock.
The gains per axis are those of a critically damped g-h-k filter (fading memory, Morrison 1969, ch. 9), so the loop
is stable at any pose rate. Horizontal acceleration error is interpreted as tilt error, as in a real EKF.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from sitl.autopilots.flow_aiding import MIN_COS_TILT, FlowTuning, Terrain, flow_velocity
from sitl.geometry.quaternion import (
    IDENTITY,
    Quat,
    Vec3,
    from_small_rotation,
    from_yaw,
    multiply,
    normalised,
    rotate,
    wrapped,
    yaw_of,
)
from sitl.world.flow_sensor import FlowMeasurement
from sitl.world.quadrotor import GRAVITY_MPS2

_HISTORY_S = 0.32  # poses older than 0.2 s delay + 0.1 s search window are never fused
_EXPECTED_GAP_S = 0.2  # EV_MAX_INTERVAL
_FUSION_STOPS_S = 0.4  # twice EV_MAX_INTERVAL
_START_S = 0.5  # poses must arrive without a gap for this time before they are used
_NORM_TOLERANCE = 1e-3  # 32-bit floats add an error of 1e-7 each
_POSITION_BANDWIDTH = 3.0  # rad/s
_YAW_BANDWIDTH = 3.0
_FLOW_BANDWIDTH = 1.5  # rad/s, of a critically damped g-h filter of the velocity
_FLOW_RECENT_S = 0.6  # flow fused within this time counts as present aiding
_ACCELERATION_LAG_S = 0.020  # low pass for the controller's damping term

ATTITUDE = 1
VELOCITY_HORIZ = 2
VELOCITY_VERT = 4
POS_HORIZ_REL = 8
POS_HORIZ_ABS = 16
POS_VERT_ABS = 32
CONST_POS_MODE = 128
PRED_POS_HORIZ_REL = 256


@dataclass(frozen=True, slots=True)
class ExternalPose:
    """One received pose: local frame with the third axis down, body FRD; NaN = not measured.

    position_variance_m2 and yaw_variance_rad2: NaN if unknown to the sender. quality: 0 unknown, 1 to 100 %.
    """

    stamp_s: float
    position: Vec3
    quat_wxyz: Quat
    position_variance_m2: float
    yaw_variance_rad2: float
    quality: int
    reset_counter: int


@dataclass(frozen=True, slots=True)
class EstimatorTuning:
    """Tuning from a firmware's parameters and constants. Noises: minimum standard deviations."""

    fuse_xy: bool
    fuse_z: bool
    fuse_yaw: bool
    noise_from_message: bool
    position_noise_m: float
    yaw_noise_rad: float
    gate: float  # standard deviations
    quality_min: int
    delay_s: float
    valid_s: float  # the horizontal position remains valid for this time after the last fused pose
    reject_s: float  # after this time of rejected poses the estimate is reset to them
    resets_in_air: float  # maximum number of such resets in flight
    flow: FlowTuning = field(default_factory=FlowTuning)


class Estimator:
    """Estimator of local position, velocity and attitude.

    on_reset(delta_position, delta_yaw) is called at each jump of the estimate. ignored: number of poses not used, by reason.
    velocity_error: a fault: the published velocity is off by this, while the position is right (PX4 issues 17466 and 22196).
    heading_error_rad: a fault: the heading follows that of the poses plus this, while the position is right (PX4 issue 14840).
    """

    def __init__(self, tuning: EstimatorTuning, on_reset: Callable[[Vec3, float], None] | None = None) -> None:
        self._on_reset = on_reset
        self.configure(tuning)
        self.position: Vec3 = (0.0, 0.0, 0.0)
        self._velocity: Vec3 = (0.0, 0.0, 0.0)
        self.velocity_error: Vec3 = (0.0, 0.0, 0.0)
        self.heading_error_rad = 0.0
        self.acceleration: Vec3 = (0.0, 0.0, 0.0)
        self.quat_wxyz: Quat = IDENTITY
        self.angular_rate: Vec3 = (0.0, 0.0, 0.0)
        self.height_offset_m = 0.0
        self.fusing = False
        self.reset_count = 0
        self.position_test_ratio = 0.0
        self.height_test_ratio = 0.0
        self.flow_test_ratio = 0.0
        self.ignored: dict[str, int] = {}
        self.origin_set = False
        self._accel_down_bias = 0.0
        self._yaw_rate_bias = 0.0
        self._history: deque[list[float]] = deque()
        self._now_s = 0.0
        self._last_pose_s = -math.inf
        self._steady_since_s = math.inf
        self._fused_xy_s = -math.inf
        self._fused_z_s = -math.inf
        self._fused_yaw_s = -math.inf
        self._fused_flow_s = -math.inf
        self._seen_flow_s = -math.inf
        self._terrain = Terrain()
        self._reset_counter = -1
        self._resets_left = self._tuning.resets_in_air
        self.started = False
        self._baro_zero = math.nan
        self._on_ground = True

    @property
    def pose_age_s(self) -> float:
        """Age (s) of the newest received pose; inf before the first."""
        return self._now_s - self._last_pose_s

    def configure(self, tuning: EstimatorTuning) -> None:
        """Apply a changed tuning."""
        self._tuning = tuning

    # -- outputs --------------------------------------------------------------------------------------------------

    @property
    def velocity(self) -> Vec3:
        """Velocity (m/s), local NED, as published and used for control."""
        (x, y, z), (ex, ey, ez) = self._velocity, self.velocity_error
        return (x + ex, y + ey, z + ez)

    @property
    def height_rate(self) -> float:
        """Derivative (m/s, down) of the estimated height, without the error of the velocity."""
        return self._velocity[2]

    @property
    def horizontal_valid(self) -> bool:
        """True if the local horizontal position is valid for position control."""
        return self.started and (not self.poses_timed_out or self._flow_holds)

    @property
    def poses_timed_out(self) -> bool:
        """True if the position is lost without other aiding: no pose was fused for valid_s."""
        return self._now_s - self._fused_xy_s > self._tuning.valid_s

    @property
    def _flow_holds(self) -> bool:
        """True if flow keeps the velocity, and so a drifting position, valid without poses."""
        f, now = self._tuning.flow, self._now_s
        aided_s = max(self._fused_xy_s, self._fused_flow_s)
        seen = now - self._seen_flow_s <= f.seen_s and now - self._terrain.measured_s <= f.terrain_s
        return seen and now - aided_s <= f.valid_s

    @property
    def flow_tuning(self) -> FlowTuning:
        """The tuning of flow fusion."""
        return self._tuning.flow

    @property
    def flow_fused(self) -> bool:
        """True while flow is fused."""
        return self._now_s - self._fused_flow_s <= _FLOW_RECENT_S

    @property
    def height_above_ground_m(self) -> float:
        """Height (m) of the body above what is below it, from the range finder; NaN if not known."""
        if self._now_s - self._terrain.measured_s > min(self._tuning.flow.terrain_s, 5.0):
            return math.nan
        return self._terrain.height_m(self._now_s, self._velocity[2])

    @property
    def position_accuracy_m(self) -> float:
        """Standard deviation (m) of the horizontal position.

        It grows while no pose is fused, slowly with flow.
        """
        silent = min(max(self._now_s - self._fused_xy_s, 0.0), 60.0)
        if self.flow_fused:
            return 0.03 + 0.05 * math.sqrt(silent)
        return 0.03 + 0.05 * silent + 0.05 * silent * silent

    @property
    def flags(self) -> int:
        """Bits of ESTIMATOR_STATUS_FLAGS."""
        if not self.started:
            return ATTITUDE | VELOCITY_VERT | POS_VERT_ABS | CONST_POS_MODE
        flags = ATTITUDE | VELOCITY_VERT | POS_VERT_ABS
        if self.horizontal_valid:
            flags |= VELOCITY_HORIZ | POS_HORIZ_REL
            if self.origin_set:
                flags |= POS_HORIZ_ABS
        if self._now_s - self._fused_xy_s <= 0.6 or self.flow_fused:
            flags |= PRED_POS_HORIZ_REL
        return flags

    @property
    def yaw(self) -> float:
        """Heading in the local frame, rad."""
        return yaw_of(self.quat_wxyz)

    # -- each step ------------------------------------------------------------------------------------------------

    def predict(self, now_s: float, dt_s: float, gyro: Vec3, specific_force: Vec3, on_ground: bool) -> None:
        """Integrate one IMU sample (FRD). on_ground (land detector) allows any number of resets."""
        self._now_s = now_s
        self._on_ground = on_ground
        if on_ground:
            self._resets_left = self._tuning.resets_in_air
        rate = (gyro[0], gyro[1], gyro[2] - self._yaw_rate_bias)
        self.angular_rate = rate
        turn = from_small_rotation(rate[0] * dt_s, rate[1] * dt_s, rate[2] * dt_s)
        self.quat_wxyz = normalised(multiply(self.quat_wxyz, turn))
        f = rotate(self.quat_wxyz, specific_force)
        ax, ay, az = f[0], f[1], f[2] + GRAVITY_MPS2 + self._accel_down_bias
        s = min(dt_s / _ACCELERATION_LAG_S, 1.0)
        a = self.acceleration
        self.acceleration = (a[0] + s * (ax - a[0]), a[1] + s * (ay - a[1]), a[2] + s * (az - a[2]))
        self.fusing = now_s - self._last_pose_s <= _FUSION_STOPS_S and self.started
        if not self.started:  # constant position mode until the first pose: level, at rest
            self._velocity = (0.0, 0.0, 0.0)
            self.quat_wxyz = from_yaw(self.yaw)
        else:
            vx, vy, vz = self._velocity
            vx, vy, vz = vx + ax * dt_s, vy + ay * dt_s, vz + az * dt_s
            x, y, z = self.position
            self._velocity = (vx, vy, vz)
            self.position = (x + vx * dt_s, y + vy * dt_s, z + vz * dt_s)
        x, y, z = self.position
        self._history.append([now_s, x, y, z, self.yaw, self._velocity[0], self._velocity[1]])
        while self._history[0][0] < now_s - _HISTORY_S:
            self._history.popleft()

    def correct_baro(self, height_m: float, dt_s: float) -> None:
        """Update with the barometric height (m).

        While the height of poses is fused, its zero is adjusted to the estimate; otherwise it corrects the estimate.
        """
        if math.isnan(self._baro_zero) or not self.started:
            self._baro_zero = height_m + self.position[2]
            return
        if self._now_s - self._fused_z_s < 0.5:
            self._baro_zero += 0.02 * (height_m + self.position[2] - self._baro_zero)
            return
        self._correct_height(self._baro_zero - height_m - self.position[2], self._now_s, dt_s, 1.0)

    # -- flow and range -------------------------------------------------------------------------------------------

    def take_range(self, range_m: float) -> None:
        """Process a range (m) of the range finder that looks down."""
        sensor_m = self._tuning.flow.range_position_m
        self._terrain.measure(self._now_s, range_m, self.quat_wxyz, sensor_m, self._velocity[2])

    def take_flow(self, flow: FlowMeasurement, read_s: float) -> None:
        """Process one flow: fuse it, reset the velocity to it, or ignore it and count the reason.

        read_s: its time of reading. Flow alone does not start the estimator, and on the ground it is not used.
        """
        if flow.quality < self._tuning.flow.quality_min or self._too_fast(flow):
            self._ignore("flow quality" if flow.quality < self._tuning.flow.quality_min else "flow rate")
            return
        self._seen_flow_s = self._now_s
        if self._tuning.flow.fuse and self.started and not self._on_ground:
            self._fuse_flow(flow, read_s - self._tuning.flow.delay_s - 0.5 * flow.interval_s)

    def _too_fast(self, flow: FlowMeasurement) -> bool:
        most = self._tuning.flow.rate_max_radps * flow.interval_s
        return math.hypot(*flow.flow_rad) > most or math.hypot(flow.gyro_rad[0], flow.gyro_rad[1]) > most

    def _fuse_flow(self, flow: FlowMeasurement, stamp: float) -> None:
        t, height_m, past = self._tuning.flow, self.height_above_ground_m, self._at(stamp)
        low_m, high_m = t.height_m
        tilted = rotate(self.quat_wxyz, (0.0, 0.0, 1.0))[2] < MIN_COS_TILT
        if past is None or tilted or not low_m <= height_m <= high_m:
            self._ignore("flow height or tilt")
            return
        north, east, distance_m = flow_velocity(flow, t.position_m, height_m, self.quat_wxyz, self._velocity)
        ix, iy = north - past[5], east - past[6]
        noise_mps = t.noise(flow.quality) * distance_m
        silent_s = self._now_s - max(self._fused_xy_s, self._fused_flow_s)
        deviation_mps = 0.1 + 0.3 * min(max(silent_s, 0.0), 5.0)
        self.flow_test_ratio = max(ix * ix, iy * iy) / (t.gate**2 * (noise_mps**2 + deviation_mps**2))
        if self.flow_test_ratio <= 1.0:
            self._correct_velocity(ix, iy, stamp, (t.noise_radps[0] / t.noise(flow.quality)) ** 2)
            self._fused_flow_s = stamp
            return
        self._ignore("flow gate")
        if silent_s > t.reset_s:
            self._move_velocity(ix, iy)
            self._fused_flow_s = stamp

    def _correct_velocity(self, ix: float, iy: float, stamp: float, weight: float) -> None:
        """Correct velocity and tilt by an innovation of the velocity (m/s)."""
        dt = min(max(stamp - self._fused_flow_s, 0.004), _EXPECTED_GAP_S)
        fade = math.exp(-_FLOW_BANDWIDTH * dt)
        g, h = weight * (1.0 - fade * fade), weight * (1.0 - fade) ** 2 / dt
        self._move_velocity(g * ix, g * iy)
        tilt = from_small_rotation(h * iy / GRAVITY_MPS2, -h * ix / GRAVITY_MPS2, 0.0)
        self.quat_wxyz = normalised(multiply(tilt, self.quat_wxyz))

    def _move_velocity(self, dvx: float, dvy: float) -> None:
        vx, vy, vz = self._velocity
        self._velocity = (vx + dvx, vy + dvy, vz)
        for entry in self._history:
            entry[5] += dvx
            entry[6] += dvy

    # -- external poses -------------------------------------------------------------------------------------------

    def take(self, pose: ExternalPose) -> None:
        """Process one pose: fuse it, reset the estimate to it, or ignore it and count the reason."""
        stamp = pose.stamp_s - self._tuning.delay_s
        if not self._usable(pose, stamp):
            return
        gap = stamp - self._last_pose_s
        if gap > _EXPECTED_GAP_S:
            self._steady_since_s = stamp
        self._last_pose_s = stamp
        past = self._at(stamp)
        if past is None:
            return
        if not self.started:
            if stamp - self._steady_since_s >= _START_S:
                self._start(pose, past)
            return
        if pose.reset_counter != self._reset_counter:
            self._reset_counter = pose.reset_counter
            self._reset_to(pose, past, stamp, xy=True, z=True, yaw=True)
            return
        dt = min(max(gap, 0.004), _EXPECTED_GAP_S)
        self._fuse_position(pose, past, stamp, dt)
        self._fuse_heading(pose, past, stamp, dt)

    def offset_height(self, altitude_m: float) -> None:
        """Offset the local height by the altitude of an origin that was set before the first pose.

        The offset remains for the whole flight.
        """
        self.height_offset_m = altitude_m
        x, y, _ = self.position
        self.position = (x, y, altitude_m)

    def move_height_datum(self, up_m: float) -> None:
        """Move the zero of the height, as a change of the height source does.

        From now on the estimate reads up_m higher.
        """
        self.height_offset_m -= up_m
        self._baro_zero -= up_m
        self._shift(0.0, 0.0, -up_m, 0.0, 0.0, 0.0, self._now_s, 0.0)
        self.reset_count += 1
        if self._on_reset is not None:
            self._on_reset((0.0, 0.0, -up_m), 0.0)

    def _usable(self, pose: ExternalPose, stamp: float) -> bool:
        if pose.quality < self._tuning.quality_min:
            return self._ignore("quality")
        if stamp <= self._last_pose_s + 0.002:
            return self._ignore("repeated")
        if stamp < self._now_s - _HISTORY_S + 0.02:
            return self._ignore("late")
        if stamp > self._now_s + _EXPECTED_GAP_S:
            return self._ignore("future")
        return True

    def _ignore(self, why: str) -> bool:
        self.ignored[why] = self.ignored.get(why, 0) + 1
        return False

    def _at(self, stamp: float) -> list[float] | None:
        """Return the estimate at a past time, or the newest one for a stamp slightly in the future.

        Elements: stamp (s), position (3, m), yaw (rad), horizontal velocity (2, m/s).
        """
        later = None
        for entry in reversed(self._history):
            if entry[0] <= stamp:
                if later is None:
                    return entry
                f = (stamp - entry[0]) / (later[0] - entry[0])
                turn = wrapped(later[4] - entry[4])
                mixed = [a + f * (b - a) for a, b in zip(entry[:4], later[:4], strict=True)]
                speed = [a + f * (b - a) for a, b in zip(entry[5:], later[5:], strict=True)]
                return [*mixed, entry[4] + f * turn, *speed]
            later = entry
        return later

    def _start(self, pose: ExternalPose, past: list[float]) -> None:
        if not (self._tuning.fuse_xy and self._position_of(pose)):
            self._ignore("not configured" if not self._tuning.fuse_xy else "not finite")
            return
        self.started = True
        self._reset_counter = pose.reset_counter
        self._reset_to(pose, past, pose.stamp_s, xy=True, z=True, yaw=True)

    def _position_of(self, pose: ExternalPose) -> bool:
        return all(math.isfinite(c) for c in pose.position)

    def _yaw_of(self, pose: ExternalPose) -> float:
        q = pose.quat_wxyz
        norm = math.sqrt(sum(c * c for c in q))
        if not math.isfinite(norm) or abs(norm - 1.0) > _NORM_TOLERANCE:
            return math.nan
        return wrapped(yaw_of(q) + self.heading_error_rad)

    def _reset_to(self, pose: ExternalPose, past: list[float], stamp: float, xy: bool, z: bool, yaw: bool) -> None:
        dx = dy = dz = turn = 0.0
        if self._position_of(pose):
            if xy and self._tuning.fuse_xy:
                dx = pose.position[0] - past[1]
                dy = pose.position[1] - past[2]
                self._fused_xy_s = stamp
            if z and self._tuning.fuse_z:
                dz = pose.position[2] + self.height_offset_m - past[3]
                self._fused_z_s = stamp
        heading = self._yaw_of(pose)
        if yaw and self._tuning.fuse_yaw and math.isfinite(heading):
            turn = wrapped(heading - past[4])
            self._fused_yaw_s = stamp
        self._baro_zero += dz
        self._shift(dx, dy, dz, 0.0, 0.0, 0.0, stamp, turn)
        if turn:  # the velocity is known in the body frame, so it rotates with the heading
            self._velocity = rotate(from_yaw(turn), self._velocity)
        self.reset_count += 1
        if self._on_reset is not None:
            self._on_reset((dx, dy, dz), turn)

    def _shift(self, dx: float, dy: float, dz: float, dvx: float, dvy: float, dvz: float, stamp: float, turn: float) -> None:
        """Correct position, velocity and heading at `stamp`, and propagate the change to now.

        The history is corrected, too; by a velocity change only together with a change of position.
        """
        if dx or dy:
            for entry in self._history:
                age = entry[0] - stamp
                entry[1] += dx + dvx * age
                entry[2] += dy + dvy * age
                entry[5] += dvx
                entry[6] += dvy
        if dz:
            for entry in self._history:
                entry[3] += dz + dvz * (entry[0] - stamp)
        if turn:
            for entry in self._history:
                entry[4] += turn
        age = self._now_s - stamp
        x, y, z = self.position
        self.position = (x + dx + dvx * age, y + dy + dvy * age, z + dz + dvz * age)
        vx, vy, vz = self._velocity
        self._velocity = (vx + dvx, vy + dvy, vz + dvz)
        if turn:
            self.quat_wxyz = normalised(multiply(from_yaw(turn), self.quat_wxyz))

    def _fuse_position(self, pose: ExternalPose, past: list[float], stamp: float, dt: float) -> None:
        if not self._position_of(pose):
            self._ignore("not finite")
            return
        ix, iy = pose.position[0] - past[1], pose.position[1] - past[2]
        iz = pose.position[2] + self.height_offset_m - past[3]
        noise = self._tuning.position_noise_m**2
        if self._tuning.noise_from_message and math.isfinite(pose.position_variance_m2):
            noise = max(noise, pose.position_variance_m2)
        gate = self._tuning.gate**2 * (noise + min(self.position_accuracy_m, 0.5) ** 2)
        self.position_test_ratio = max(ix * ix, iy * iy) / gate
        self.height_test_ratio = iz * iz / gate
        if self._tuning.fuse_xy:
            if self.position_test_ratio <= 1.0:
                self._correct_horizontal(ix, iy, stamp, dt)
                self._fused_xy_s = stamp
            else:
                self._ignore("position gate")
                if stamp - self._fused_xy_s > self._tuning.reject_s and self._may_reset():
                    self._reset_to(pose, past, stamp, xy=True, z=False, yaw=False)
        if self._tuning.fuse_z:
            if self.height_test_ratio <= 1.0:
                self._correct_height(iz, stamp, dt, _POSITION_BANDWIDTH)
                self._fused_z_s = stamp
            else:
                self._ignore("height gate")
                if stamp - self._fused_z_s > self._tuning.reject_s and self._may_reset():
                    self._reset_to(pose, past, stamp, xy=False, z=True, yaw=False)

    def _may_reset(self) -> bool:
        if self._on_ground:
            return True
        self._resets_left -= 1
        return self._resets_left >= 0

    def _correct_horizontal(self, ix: float, iy: float, stamp: float, dt: float) -> None:
        fade = math.exp(-_POSITION_BANDWIDTH * dt)
        g = 1.0 - fade**3
        h = 1.5 * (1.0 - fade) ** 2 * (1.0 + fade) / dt
        k = (1.0 - fade) ** 3 / (dt * dt)
        self._shift(g * ix, g * iy, 0.0, h * ix, h * iy, 0.0, stamp, 0.0)
        # a tilt error t rotates the hover force (0, 0, -g), which causes the acceleration error (-g t_e, g t_n)
        tilt = from_small_rotation(k * iy / GRAVITY_MPS2, -k * ix / GRAVITY_MPS2, 0.0)
        self.quat_wxyz = normalised(multiply(tilt, self.quat_wxyz))

    def _correct_height(self, iz: float, stamp: float, dt: float, bandwidth: float) -> None:
        fade = math.exp(-bandwidth * dt)
        h = 1.5 * (1.0 - fade) ** 2 * (1.0 + fade) / dt
        self._shift(0.0, 0.0, (1.0 - fade**3) * iz, 0.0, 0.0, h * iz, stamp, 0.0)
        self._accel_down_bias += (1.0 - fade) ** 3 / (dt * dt) * iz

    def _fuse_heading(self, pose: ExternalPose, past: list[float], stamp: float, dt: float) -> None:
        heading = self._yaw_of(pose)
        if not self._tuning.fuse_yaw or math.isnan(heading):
            return
        innovation = wrapped(heading - past[4])
        noise = self._tuning.yaw_noise_rad**2
        if self._tuning.noise_from_message and math.isfinite(pose.yaw_variance_rad2):
            noise = max(noise, pose.yaw_variance_rad2)
        if innovation * innovation <= self._tuning.gate**2 * (noise + 0.02**2):
            fade = math.exp(-_YAW_BANDWIDTH * dt)
            self._shift(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, stamp, (1.0 - fade * fade) * innovation)
            self._yaw_rate_bias -= (1.0 - fade) ** 2 / dt * innovation
            self._fused_yaw_s = stamp
            return
        self._ignore("yaw gate")
        if stamp - self._fused_yaw_s > self._tuning.reject_s and self._may_reset():
            self._reset_to(pose, past, stamp, xy=False, z=False, yaw=True)
