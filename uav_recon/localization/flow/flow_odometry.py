"""Flow odometry: motion of the body by optical flow, a gyro and the range below.

Flow less the turn of the gyro, times the distance along the beam, is the velocity of the sensor across the beam; less lever arm
times turn rate it is that of the body. The surface below is taken to be level; where the range steps, it is another one.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from uav_recon.localization.flow.flow_calibration import DELAYS_S, FlowCalibration, FlowErrors
from uav_recon.localization.flow.flow_samples import FlowGeometry, FlowSamples, flow_samples
from uav_recon.localization.flow.measured_motion import MeasuredMotion
from uav_recon.localization.flow.sample_buffer import SampleBuffer
from uav_recon.localization.flow.surface_height import SurfaceHeight
from uav_recon.localization.flow.turn_track import Turned, TurnTrack
from uav_recon.localization.flow.velocity_integral import VelocityIntegral
from uav_recon.types.flow import FlowReadings
from uav_recon.types.frames import FloatArray
from uav_recon.types.pose import Pose

_KEPT = 1024  # readings: twenty seconds and more
_SHORTEST_S = 1e-3  #: reject: optical flow over a shorter time
_LONGEST_S = 0.5  #: reject: optical flow over a longer time
_FASTEST_RADPS = 35.0  #: reject: optical flow, and turns of its gyro, beyond the range of any sensor
_LONGEST_RANGE_M = 100.0  #: reject: a longer range below
_NO_GYRO = np.full(3, math.nan)
_LEAD_S = 1.0  # of the track of turns before the first reading
_MARGIN_S = 0.9  # readings beside the asked time that are looked at, too
_BRIDGED_S = 0.7  #: reject: motion by optical flow with a longer gap between two readings that count
_AHEAD_S = 0.25  #: reject: motion by optical flow until later than this after the last reading, or before the first
_GYRO_BESIDE_S = 0.15  #: reject: the flow sensor's own gyro farther in time from its readings
_ACCELERATION_MPS2 = 1.5  # rms, within a gap and ahead of the readings, after ...
_STEADY_S = 0.1  # ... this time, in which a body keeps its velocity ...
_STEADY_MPS2 = 0.5  # ... but for this
_BIAS_MPS = 0.01  # of the velocity, rms: what does not average out
_TURN_BIAS_RADPS = 0.003  # of a gyro, rms
_RANGE_SHARE, _RANGE_M = 0.015, 0.02  # errors of the range, rms
_ALONG_BEAM_M = 1.0  # rms, where the ranges do not show a climb
_CLIMB_M = 0.025  # rms, of a climb that they show over one place
_SLOPE = 3.0  # rms, of what is below, against the level way: round furniture has no step
_REFERENCE_S = 0.4  # of an interval of the reference
_REFERENCE_APART_S = 0.25  #: reject: an interval of the reference with a longer gap between two readings that count
_REFERENCE_GAP_S = 0.6  #: reject: an interval of the reference that is longer
_REFERENCE_OLD_S = 5.0  #: reject: an interval of the reference that is older than the newest reading by this
_LEAST_REFERENCE_M = 0.03  #: reject: an interval of the reference with less flow than this: it is noise


class FlowOdometry:
    """Keeps readings, and answers how far the body moved.

    geometry: positions of the sensors. turned: turn of the body by the camera's gyro between two instants, as a rotation vector
    (3,) in body axes; None if it is not known: then the flow sensor's own gyro is used. A call takes no longer than 1 ms.
    """

    def __init__(self, geometry: FlowGeometry, turned: Turned | None = None) -> None:
        self._geometry = geometry
        self._flows = SampleBuffer(_KEPT, 8)  # stamp, interval, flow x y, own gyro x y z, quality
        self._ranges = SampleBuffer(_KEPT, 2)
        self._turns = TurnTrack(turned or _unknown, self._turned_by_own_gyro)
        self._calibration = FlowCalibration()
        self._reference: deque[tuple[float, Pose, float]] = deque(maxlen=256)

    @property
    def errors(self) -> FlowErrors:
        """Estimated scale and delay of the flow."""
        return self._calibration.errors

    @property
    def newest_s(self) -> float:
        """Stamp of the newest reading of flow, -inf without one."""
        return self._flows.newest_s

    def add(self, readings: FlowReadings) -> None:
        """Keep the readings that are newer than those before."""
        (fresh,) = np.nonzero(readings.stamps_s > self._flows.newest_s)
        for k in fresh.tolist():
            flow_rad, gyro_rad, interval_s = readings.flow_rad[k], readings.gyro_rad[k], float(readings.intervals_s[k])
            most_rad = _FASTEST_RADPS * interval_s
            if not (_SHORTEST_S <= interval_s <= _LONGEST_S and np.abs(flow_rad).max() <= most_rad):
                continue
            gyro_rad = gyro_rad if np.abs(gyro_rad[:2]).max() <= most_rad else _NO_GYRO
            self._flows.append(readings.stamps_s[k], interval_s, *flow_rad, *gyro_rad, readings.quality[k])
        for k in np.nonzero(readings.range_stamps_s > self._ranges.newest_s)[0].tolist():
            if 0.0 < readings.ranges_m[k] < _LONGEST_RANGE_M:
                self._ranges.append(readings.range_stamps_s[k], readings.ranges_m[k])
        if len(fresh):
            self._turns.extend(float(readings.stamps_s[fresh[0]]) - _LEAD_S, self.newest_s)
            self._calibrate()

    def add_reference(self, stamp_s: float, odom_from_body: Pose, sigma_m: float) -> None:
        """Learn scale and delay from a pose of a track that is sure.

        sigma_m: rms error of a position against the one before.
        """
        if not self._reference or stamp_s > self._reference[-1][0]:
            self._reference.append((stamp_s, odom_from_body, sigma_m))
            self._calibrate()

    def moved(self, from_s: float, to_s: float, odom_from_body: Pose) -> MeasuredMotion | None:
        """Return the motion of the body's origin, None if the readings do not tell it.

        odom_from_body: pose at from_s; its attitude counts.
        """
        if not from_s < to_s:
            return None
        found = self._samples(from_s, to_s, odom_from_body)
        if found is None:
            return None
        samples, surface = found
        samples = samples.selected(samples.valid)
        if len(samples.instants_s) < 2:
            return None
        integral = VelocityIntegral.between(from_s, to_s, samples.instants_s)
        if integral.bridged_s > _BRIDGED_S or max(integral.before_s, integral.after_s) > _AHEAD_S:
            return None
        return self._motion(samples, integral, surface.climb_m(from_s, to_s), to_s - from_s)

    def _motion(
        self, samples: FlowSamples, integral: VelocityIntegral, climb_m: float | None, duration_s: float
    ) -> MeasuredMotion:
        """Return the motion across the beam, and by the ranges along it.

        climb_m: None if they do not show it.
        """
        weights_s = integral.weights_s
        velocities_mps = samples.velocities_mps(self.errors.scale)
        across_m = weights_s @ velocities_mps
        beam = np.tensordot(weights_s, samples.odom_from_body[:, :, 2], 1)
        beam = beam / np.linalg.norm(beam)
        plane, along = np.eye(3) - np.outer(beam, beam), np.outer(beam, beam)
        covariance = self._covariance(samples, integral, velocities_mps, duration_s)
        moved_m = across_m + beam * ((climb_m or 0.0) - across_m[2]) / beam[2]
        level_m = float(np.linalg.norm(moved_m[:2]))
        along_m = _ALONG_BEAM_M if climb_m is None else math.hypot(_CLIMB_M, _SLOPE * level_m)
        return MeasuredMotion(moved_m, plane @ covariance @ plane + along_m**2 * along)

    def _covariance(
        self, samples: FlowSamples, integral: VelocityIntegral, velocities_mps: FloatArray, duration_s: float
    ) -> FloatArray:
        """Return the covariance (3, 3) across the beam.

        It holds noise, gaps and biases, and the errors of scale, range and delay.
        """
        weights_s, errors = integral.weights_s, self.errors
        height_m = float(np.mean(samples.distance_m))
        gap_m = _coasted_m(integral.before_s) + _coasted_m(integral.after_s)
        gap_s = max(integral.bridged_s - _STEADY_S, 0.0)  # the way through a gap, or a part of it, at a wrong velocity
        gap_m += _ACCELERATION_MPS2 * gap_s * min(duration_s, gap_s) / 4.0
        bias_m = duration_s * math.hypot(_BIAS_MPS, _TURN_BIAS_RADPS * height_m)
        noise_m2 = float(np.sum((weights_s * samples.noise_mps) ** 2)) + gap_m**2 + bias_m**2
        flown_m = weights_s @ (samples.flow_mps / errors.scale - samples.rate_mps)
        scaled_m = weights_s @ samples.flow_mps * errors.scale_sigma / errors.scale**2
        range_share = math.hypot(_RANGE_SHARE, _RANGE_M / max(height_m, 0.2))
        change_mps = (velocities_mps[-1] - velocities_mps[0]) + (samples.rate_mps[-1] - samples.rate_mps[0])
        late_m = change_mps * errors.delay_sigma_s
        return (
            noise_m2 * np.eye(3)
            + np.outer(scaled_m, scaled_m)
            + range_share**2 * np.outer(flown_m, flown_m)
            + np.outer(late_m, late_m)
        )

    def _samples(self, from_s: float, to_s: float, odom_from_body: Pose) -> tuple[FlowSamples, SurfaceHeight] | None:
        """Return the samples of the readings around a time, and the surface below.

        odom_from_body: at from_s.
        """
        delay_s = self.errors.delay_s
        rows = self._flows.between(from_s - _MARGIN_S, to_s + _MARGIN_S + delay_s)
        if not len(rows):
            return None
        self._turns.extend(from_s - _MARGIN_S, max(self._flows.newest_s, to_s))
        ranges = self._ranges.between(from_s - 2.0 * _MARGIN_S, to_s + 2.0 * _MARGIN_S)
        start_s, end_s = self._turns.covered_s
        if not (start_s <= from_s and to_s <= end_s + _AHEAD_S):
            return None
        rows = rows[(rows[:, 0] - rows[:, 1] - delay_s >= start_s) & (rows[:, 0] - delay_s <= end_s)]
        ranges = ranges[(ranges[:, 0] >= start_s) & (ranges[:, 0] <= end_s)]
        if not len(rows):
            return None
        ends_s, intervals_s = rows[:, 0] - delay_s, rows[:, 1]
        instants_s, count = ends_s - intervals_s / 2.0, len(rows)
        asked_s = np.concatenate((ends_s, ends_s - intervals_s, instants_s, ranges[:, 0], [from_s]))
        angles_rad, start_from_body = self._turns.at(asked_s)
        attitudes = odom_from_body.rotation() @ start_from_body[-1].T @ start_from_body
        rates_radps = (angles_rad[:count] - angles_rad[count : 2 * count]) / intervals_s[:, None]
        surface = SurfaceHeight.of(ranges[:, 0], ranges[:, 1], attitudes[3 * count : -1], self._geometry.range_m)
        samples = flow_samples(
            instants_s,
            rates_radps,
            rows[:, 2:4] / intervals_s[:, None],
            rows[:, 7],
            attitudes[2 * count : 3 * count],
            surface,
            self._geometry,
            self.errors.scale,
        )
        return samples, surface

    def _calibrate(self) -> None:
        """Use the intervals of the reference whose readings are all there."""
        reference = self._reference
        while len(reference) > 1:
            start_s = reference[0][0]
            later = [k for k in range(1, len(reference)) if reference[k][0] - start_s >= _REFERENCE_S]
            if not later or reference[later[0]][0] + DELAYS_S[-1] + 0.1 > self._flows.newest_s:
                return
            start, end = reference[0], reference[later[0]]
            for _ in range(later[0]):
                reference.popleft()
            recent = self._flows.newest_s - end[0] <= _REFERENCE_OLD_S
            if recent and end[0] - start[0] <= _REFERENCE_GAP_S:
                self._use(*start, *end[:2])

    def _use(self, from_s: float, start: Pose, sigma_m: float, to_s: float, end: Pose) -> None:
        """Use one interval of the reference, if its readings count."""
        latest_s = to_s + float(DELAYS_S[-1])
        found = self._samples(from_s, latest_s, start)
        if found is None:
            return
        samples, _ = found
        stamps_s = samples.instants_s + self.errors.delay_s
        inside = samples.valid & (stamps_s >= from_s - 0.1) & (stamps_s <= latest_s + 0.1)
        samples, stamps_s = samples.selected(inside), stamps_s[inside]
        if len(stamps_s) < 3 or stamps_s[0] > from_s or stamps_s[-1] < latest_s:
            return
        if np.diff(stamps_s).max() > _REFERENCE_APART_S:
            return
        weights_s = VelocityIntegral.between(from_s, to_s, samples.instants_s).weights_s
        beam = np.tensordot(weights_s, samples.odom_from_body[:, :, 2], 1)
        beam = beam / np.linalg.norm(beam)
        moved_m = end.translation_m - start.translation_m
        expected_m = moved_m - beam * (beam @ moved_m) + weights_s @ samples.turn_mps
        if np.linalg.norm(expected_m) < _LEAST_REFERENCE_M:
            return
        path_m = np.zeros((len(stamps_s), 3))
        mean_mps = (samples.flow_mps[1:] + samples.flow_mps[:-1]) / 2.0
        np.cumsum(mean_mps * np.diff(stamps_s)[:, None], axis=0, out=path_m[1:])
        measured_m = np.stack(
            [np.interp(to_s + DELAYS_S, stamps_s, path) - np.interp(from_s + DELAYS_S, stamps_s, path) for path in path_m.T],
            axis=1,
        )
        flow_sigma_m = float(np.sqrt(np.sum((weights_s * samples.noise_mps) ** 2)))
        self._calibration.add(measured_m, expected_m, flow_sigma_m, math.sqrt(2.0) * sigma_m)

    def _turned_by_own_gyro(self, from_s: float, to_s: float) -> FloatArray | None:
        """Return the turn by the sensor's own gyro, None where it has none or no reading is near."""
        rows = self._flows.between(from_s - 0.5, to_s + 0.5)
        rows = rows[np.isfinite(rows[:, 4:6]).all(axis=1)]
        if not len(rows):
            return None
        middles_s, middle_s = rows[:, 0] - rows[:, 1] / 2.0, (from_s + to_s) / 2.0
        if np.abs(middles_s - middle_s).min() > _GYRO_BESIDE_S:
            return None
        rates_radps = np.clip(np.nan_to_num(rows[:, 4:7]) / rows[:, 1:2], -_FASTEST_RADPS, _FASTEST_RADPS)
        return np.array([np.interp(middle_s, middles_s, rates_radps[:, k]) for k in range(3)]) * (to_s - from_s)


def _coasted_m(time_s: float) -> float:
    """Return the rms error of a velocity that is kept for a time, as a way."""
    return _STEADY_MPS2 * time_s**2 + (_ACCELERATION_MPS2 - _STEADY_MPS2) * max(time_s - _STEADY_S, 0.0) ** 2


def _unknown(from_s: float, to_s: float) -> None:
    """Return None: there is no gyro."""
