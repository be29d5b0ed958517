"""Trajectory generation: the fastest pass along a band, sampled, smoothed and joined."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uav_recon.config import MotionConfig
from uav_recon.motion.clearance import ClearanceMap, clearances_at, coarse_clearances_at, free_distances
from uav_recon.motion.elastic_band import SPAN_M, SPAN_S, ElasticBand
from uav_recon.motion.initial_state import InitialState
from uav_recon.motion.node_speed_limits import CurveNodes, NodeLimits, node_speed_limits
from uav_recon.motion.sight_forecast import SightForecast
from uav_recon.motion.time_parameterization import (
    FEEDFORWARD_OVERSHOOT_S,
    MAX_PACE,
    PER_SPAN,
    TINY,
    Curve,
    fastest,
    node_times,
    sampled,
    smoothed,
)
from uav_recon.motion.time_scaling import STEP_S
from uav_recon.motion.yaw_policy import AT_VIEWS, USUAL_SHARE, YawPolicy
from uav_recon.types.frames import BoolArray, FloatArray
from uav_recon.types.trajectory import Trajectory

OPEN_M = 0.3  # full speed where the clearance exceeds the planning clearance by this
SPREAD_M = 0.2  # the speed limit of a tight place applies this far before and behind it: smoothing mixes neighbours
PASSAGE_MPS = 0.3  #: brake: speed where only a fine map shows enough clearance
TIGHT_LESS_M = 0.02  # clearance below the planning distance from which on that is so
RUN_ON_MPS = 0.2  #: brake: the speed limit of run_on_s is never lower: a vehicle has to make progress
SHARE = 0.97  # share of the acceleration limits: the rest covers the distance between nodes ...
FULL = 0.995  # ... and share of the speed limits
BRAKING = 0.7  # share of the acceleration with which a motion that is entered too fast brakes
MIN_MPS2 = 0.3  # the limit from the view direction is never lower: a vehicle has to make progress
TRIES = 4
SLOWEST = 2.0  # spans a second: a lower pace at the start of a moving band would make its spans short


@dataclass(frozen=True, slots=True, eq=False)
class TrajectorySamples:
    """Samples (N + 1, 5) of x, y, z, yaw, pitch each STEP_S, and the instants of the views.

    Row 0 is one step before the start; views_s is relative to the start. Not feasible: the entry is too fast for what follows.
    """

    rows: FloatArray
    views_s: FloatArray
    feasible: bool = True

    def rates(self) -> tuple[FloatArray, FloatArray]:
        """Return the first and second derivatives (N, 5) from the start on; the last row is at rest."""
        rate, change = np.zeros_like(self.rows[1:]), np.zeros_like(self.rows[1:])
        rate[:-1] = (self.rows[2:] - self.rows[:-2]) / (2 * STEP_S)
        change[:-1] = (self.rows[2:] - 2 * self.rows[1:-1] + self.rows[:-2]) / STEP_S**2
        return rate, change

    def trajectory(self, start_s: float, map_epoch: int, identifier: int, clearance_m: float | None = None) -> Trajectory:
        """Return the trajectory as it is sent to the pilot."""
        rate, change = self.rates()
        rows = self.rows[1:]
        return Trajectory(
            start_s, STEP_S, rows[:, :3], rate[:, :3], change[:, :3], rows[:, 3], rate[:, 3], rows[:, 4], self.views_s,
            map_epoch, identifier, clearance_m,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class TrajectoryGenerator:
    """The limits (SI, radians), and the generation of trajectories along bands within them."""

    speed: float
    tight_speed: float
    climb: float
    descent: float
    acceleration: float
    rate: float
    yaw_acceleration: float
    blur_radps: float
    blur_distance_m: float
    clearance_m: float
    hull_m: float
    run_on_s: float
    box: int
    yaw_policy: YawPolicy

    @staticmethod
    def of(config: MotionConfig, clearance_m: float, hull_m: float, yaw_policy: YawPolicy = AT_VIEWS) -> TrajectoryGenerator:
        """Return the limits of a config."""
        return TrajectoryGenerator(
            speed=FULL * config.speed_mps,
            tight_speed=FULL * config.tight_speed_mps,
            climb=FULL * config.climb_mps,
            descent=FULL * config.descent_mps,
            acceleration=config.acceleration_mps2,
            rate=math.radians(FULL * config.yaw_rate_degps),
            yaw_acceleration=math.radians(config.yaw_acceleration_degps2),
            blur_radps=FULL * config.blur_px / (config.focal_px * config.exposure_s),
            blur_distance_m=config.blur_distance_m,
            clearance_m=clearance_m,
            hull_m=hull_m,
            run_on_s=config.run_on_s,
            box=max(int(config.smoothing_s / 2 / STEP_S) // 2 * 2 + 1, 1),
            yaw_policy=yaw_policy,
        )

    @property
    def span_rad(self) -> float:
        """Max. turn of one span of a band, in radians."""
        return self.rate * SPAN_S

    def max_acceleration(self) -> FloatArray:
        """Return the greatest acceleration of each coordinate (5,)."""
        return np.array([self.acceleration] * 3 + [self.yaw_acceleration] * 2)

    def entry_pace(self, entry: InitialState) -> float:
        """Return the spans per second at the start of a band entered in motion.

        The first span is as long as the others, or shorter.
        """
        speed = float(np.linalg.norm(entry.velocity[:3]))
        turning = float(np.abs(entry.velocity[3:]).max())
        return max(speed / SPAN_M, turning / self.span_rad, SLOWEST)

    def continued_positions(self, entry: InitialState, overrun: float) -> tuple[FloatArray, FloatArray]:
        """Return two positions (5,) on the continuation of a moving entry.

        The first is one span on. The second is farther by the share ``overrun`` of the braking distance. All five coordinates
        brake in the time that the slowest of them needs.
        """
        speed, turning = float(np.linalg.norm(entry.velocity[:3])), float(np.abs(entry.velocity[3:]).max())
        braking_s = max(speed / self.acceleration, turning / self.yaw_acceleration) * 1.1 / SHARE
        rolled = entry.place + entry.velocity / self.entry_pace(entry)
        return rolled, rolled + entry.velocity * (0.5 * overrun * braking_s)

    def generate(
        self, band: ElasticBand, entry: InitialState, clearance_map: ClearanceMap | None, spacing_m: float,
        forecast: SightForecast | None = None,
    ) -> TrajectorySamples:  # fmt: skip
        """Return the fastest trajectory along a band.

        If smoothing and sampling leave too much acceleration, the whole trajectory is made slower. Where the result shows that
        the camera does not look in the direction of flight, the speed is limited: a body that accelerates leans.

        forecast: of what the camera will have seen. Its ages follow from the first pass, which is then made again.
        """
        curve = Curve.of(band.control)
        first = self.entry_pace(entry) ** 2 if entry.is_moving else 0.0
        cap, x, times = np.empty(len(curve.along_m)), np.empty(len(curve.along_m)), np.empty(len(curve.along_m))
        max_speed_mps = self._speed_limits(curve, clearance_map, forecast, self._estimated_times_s(curve, forecast))
        leaning_mps2 = self._lean_limits_mps2(curve, entry)
        self._limit_nodes(curve, band, entry, clearance_map, max_speed_mps, cap)
        share = SHARE
        for attempt in range(TRIES if forecast is None else TRIES + 1):
            max_acceleration_mps2 = np.minimum(share * self.acceleration, leaning_mps2)
            if not fastest(
                curve.slope, curve.bend, cap, max_speed_mps, max_acceleration_mps2, share * self.yaw_acceleration, first, x
            ):
                return TrajectorySamples(entry.rows, np.zeros(0), feasible=False)
            node_times(x, times)
            if attempt == 0 and forecast is not None:
                max_speed_mps = self._speed_limits(curve, clearance_map, forecast, forecast.begin_s + times)
                self._limit_nodes(curve, band, entry, clearance_map, max_speed_mps, cap)
                continue
            samples = self._smoothed(band, entry, curve, x, times, spacing_m)
            _, change = samples.rates()
            new = change[entry.left :]
            excess = max(
                float(np.sqrt(np.max(np.sum(new[:, :3] ** 2, axis=1)))) / self.acceleration,
                float(np.abs(new[:, 3:]).max()) / self.yaw_acceleration,
            )
            too_fast = self._too_fast_nodes(samples, entry, times, forecast)
            if excess <= 1.02 and not too_fast.any():
                break
            if excess > 1.02:
                share *= 0.98 / excess
            if too_fast.any():
                max_speed_mps[too_fast] = np.minimum(max_speed_mps[too_fast], self.yaw_policy.blind_speed_mps)
                self._limit_nodes(curve, band, entry, clearance_map, max_speed_mps, cap)
        return samples

    def _limit_nodes(
        self, curve: Curve, band: ElasticBand, entry: InitialState, clearance_map: ClearanceMap | None,
        max_speed_mps: FloatArray, cap: FloatArray,
    ) -> None:  # fmt: skip
        node_clearance_m = np.full(len(cap), np.inf)
        if clearance_map is not None:
            clearances_at(clearance_map, curve.place, node_clearance_m)
            if len(clearance_map.fine_frame):
                coarse_m = np.empty(len(cap))
                coarse_clearances_at(clearance_map, curve.place, coarse_m)
                tight = _within(curve.along_m, curve.along_m[coarse_m < self.clearance_m - TIGHT_LESS_M], SPREAD_M)
                max_speed_mps = np.where(tight, np.minimum(max_speed_mps, PASSAGE_MPS), max_speed_mps)
        nodes = CurveNodes(
            slope=curve.slope, along_m=curve.along_m, node_clearance_m=node_clearance_m, max_speed_mps=max_speed_mps,
            view_node=band.view_node, per_span=PER_SPAN,
        )  # fmt: skip
        limits = NodeLimits(
            clearance_m=self.clearance_m, open_m=OPEN_M, spread_m=SPREAD_M, speed=self.speed, tight_speed=self.tight_speed,
            climb=self.climb, descent=self.descent, rate=self.rate, blur_radps=self.blur_radps,
            blur_distance_m=self.blur_distance_m, braking=BRAKING * self.acceleration, max_pace=MAX_PACE,
        )  # fmt: skip
        node_speed_limits(nodes, limits, entry.velocity, cap)

    def _lean_limits_mps2(self, curve: Curve, entry: InitialState) -> FloatArray:
        """Return acceleration limits (M,) up to which the camera sees the path.

        There is no limit where the motion that is entered has to brake.
        """
        max_acceleration_mps2 = np.maximum(self.yaw_policy.max_acceleration_mps2(curve.slope, curve.place), MIN_MPS2)
        entry2 = float(np.sum(entry.velocity[:3] ** 2))
        return np.where(2.0 * BRAKING * self.acceleration * curve.along_m < entry2, np.inf, max_acceleration_mps2)

    def _too_fast_nodes(
        self, samples: TrajectorySamples, entry: InitialState, times: FloatArray, forecast: SightForecast | None
    ) -> BoolArray:
        """Return a mask of the nodes (M,) that contribute to samples too fast for the camera.

        times: (M,) instants at which the nodes are reached.
        """
        too_fast = np.zeros(len(samples.rows), dtype=np.bool_)
        too_fast[entry.left + 1 : -1] = self.exceeds_limit(samples, entry, forecast)
        around = np.convolve(too_fast, np.ones(2 * self.box + 1), "same") > 0.0
        return np.asarray(around[np.minimum(np.rint(times / STEP_S).astype(np.int64) + len(entry.rows) - 1, len(around) - 1)])

    def exceeds_limit(self, samples: TrajectorySamples, entry: InitialState, forecast: SightForecast | None) -> BoolArray:
        """Return a mask of the new rows of a trajectory that are too fast for the camera.

        The first and the last are not judged.
        """
        return self.yaw_policy.exceeds_limit(
            samples.rows[entry.left :], forecast, 0.0 if forecast is None else forecast.begin_s
        )

    def _speed_limits(
        self, curve: Curve, clearance_map: ClearanceMap | None, forecast: SightForecast | None, reached_s: FloatArray
    ) -> FloatArray:
        """Return the speed limits (M,) from the view direction and from obstacles ahead.

        They are infinite without a map.
        """
        if clearance_map is None:
            return np.full(len(curve.along_m), np.inf)
        seen_mps = self.yaw_policy.max_speed_mps(curve.slope, curve.place, forecast, reached_s)
        return np.minimum(seen_mps, self._silence_speed_limits(curve, clearance_map))

    def _estimated_times_s(self, curve: Curve, forecast: SightForecast | None) -> FloatArray:
        """Return about the instants (M,) at which the nodes are reached."""
        turned_rad = np.abs(np.diff(curve.place[:, 3], prepend=curve.place[0, 3]))
        step_m = np.diff(curve.along_m, prepend=0.0)
        passed_s = np.cumsum(np.maximum(step_m / (USUAL_SHARE * self.speed), turned_rad / self.rate))
        return passed_s if forecast is None else forecast.begin_s + passed_s

    def _silence_speed_limits(self, curve: Curve, clearance_map: ClearanceMap) -> FloatArray:
        """Return speeds (M,) at which an autopilot without setpoints stops before any contact.

        It flies straight on, or deflected by the lateral acceleration that it keeps, taken at the greatest speed. The
        deflection also makes it faster.
        """
        if self.run_on_s == 0.0:
            return np.full(len(curve.along_m), np.inf)
        slope, bend = curve.slope[:, :3], curve.bend[:, :3]
        flat = np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), TINY)
        across = bend - np.sum(bend * slope, axis=1, keepdims=True) / flat**2 * slope
        most = np.maximum(np.linalg.norm(bend, axis=1, keepdims=True), TINY)
        fastest_x = np.minimum((self.speed / flat) ** 2, self.acceleration / most)
        bent = slope + FEEDFORWARD_OVERSHOOT_S * np.sqrt(fastest_x) * across
        far_m = (self.speed + FEEDFORWARD_OVERSHOOT_S * self.acceleration) * self.run_on_s
        min_m = self.hull_m + 0.5 * clearance_map.resolution_m  # to the voxel's side
        finer_m = 0.5 * (clearance_map.resolution_m - clearance_map.fine_resolution_m)
        clearance_map = clearance_map._replace(fine_credit_m=finer_m)
        max_speed_mps = np.full(len(slope), np.inf)
        for heading in (slope, bent):
            way_m = np.full(len(slope), far_m)
            free_distances(clearance_map, curve.place, heading, min_m, way_m)
            faster = np.linalg.norm(heading, axis=1) / flat[:, 0]
            max_speed_mps = np.minimum(max_speed_mps, way_m / (self.run_on_s * np.maximum(faster, 1.0)))
        return np.asarray(np.maximum(max_speed_mps, RUN_ON_MPS))

    def _smoothed(
        self, band: ElasticBand, entry: InitialState, curve: Curve, x: FloatArray, times: FloatArray, spacing_m: float
    ) -> TrajectorySamples:
        """Add to the entry's continuation the smoothed difference of the path from it."""
        count, begin, half = int(np.ceil(times[-1] / STEP_S)) + 1, len(entry.rows) - 1, self.box - 1
        raw = np.empty((count, 5))
        sampled(band.control, x, times, STEP_S, raw)
        going_on = entry.continued(count - 1 + half)
        differs = np.zeros((half + len(going_on) + half, 5))
        differs[half + begin : half + begin + count] = raw
        differs[half + begin + count :] = raw[-1]
        differs[half + begin : half + len(going_on)] -= going_on[begin:]
        differs[half + len(going_on) :] -= going_on[-1] + entry.drift * np.arange(1, half + 1)[:, None]
        change = np.empty_like(going_on)
        smoothed(differs, self.box, change)
        lead_s = (begin - 1) * STEP_S
        reached_s = times[band.view_node * PER_SPAN]
        if spacing_m == np.inf:
            return TrajectorySamples(going_on + change, reached_s + lead_s)
        ends_m = curve.along_m[band.view_node * PER_SPAN]
        on_the_way_m, begin_m = [], 0.0
        for end_m in ends_m:
            on_the_way_m += list(np.arange(begin_m + spacing_m, end_m - spacing_m / 2, spacing_m))
            begin_m = float(end_m)
        on_the_way_s = np.interp(on_the_way_m, curve.along_m, times)
        return TrajectorySamples(going_on + change, np.sort(np.concatenate((on_the_way_s, reached_s))) + lead_s)


def _within(along_m: FloatArray, places_m: FloatArray, reach_m: float) -> BoolArray:
    """Return a mask (M,) of the lengths along a path that are near one of others (K,)."""
    if not len(places_m):
        return np.zeros(len(along_m), dtype=np.bool_)
    after = np.clip(np.searchsorted(places_m, along_m), 1, len(places_m)) - 1
    before = np.minimum(after + 1, len(places_m) - 1)
    nearest: BoolArray = np.minimum(np.abs(along_m - places_m[after]), np.abs(along_m - places_m[before])) <= reach_m
    return nearest
