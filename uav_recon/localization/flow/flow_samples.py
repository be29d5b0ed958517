"""Flow samples: what each reading of optical flow says about the motion of the body."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from uav_recon.localization.flow.surface_height import SurfaceHeight
from uav_recon.types.frames import BoolArray, FloatArray

LEAST_QUALITY_FACTOR = 0.1  #: reject: optical flow of a lower quality: a covered lens, the dark, a bare floor
_GOOD_QUALITY = 0.4  # from here on the noise is that of the sensor
_FASTEST_RADPS = 7.0  #: reject: faster optical flow: the sensor saturates
_NEAREST_M = 0.08  #: reject: optical flow over a nearer surface: it is out of focus
_FARTHEST_M = 8.0  #: reject: optical flow over a farther surface: its range finder, and its texture, end there
_MOST_TILTED_FACTOR = 0.8  #: reject: optical flow of a body that leans more: cosine of 37 degrees
_EQUAL = 4  #: reject: optical flow that repeats as many equal readings while the gyro turns
_TURNING_RADPS = 0.15  #: reject: the same: by how much the turn rate differs within them
#: reject: optical flow nearer in time to a step of the range: flow and range may be of different surfaces
_STEP_REJECT_S = 0.25
_STEP_FADE_S = 1.0  # until then flow may still see two surfaces: its noise is larger
_STEP_SHARE = 0.5  # of the speed, for a step down to nothing
_NOISE_RADPS = 0.05  # of a good sensor, rms
_LEAST_NOISE_MPS = 0.02
_MEDIAN_OF_PLANE = 1.18  # of the length of two components with an rms of one
_NEIGHBOURS = 5  # whose median a reading must agree with
_JUMP_SIGMAS = 4.0  #: reject: optical flow that differs from the median of its neighbours by more than this and the next one
_JUMP_MPS = 0.2  #: reject: the same: what a body accelerates in between


@dataclass(frozen=True, slots=True)
class FlowGeometry:
    """Mount of the sensors. flow_m, range_m: (3,), positions on the body, FLU."""

    flow_m: FloatArray
    range_m: FloatArray


@dataclass(frozen=True, slots=True)
class FlowSamples:
    """Samples (N,) at the middle of the intervals of readings.

    instants_s: (N,). odom_from_body: (N, 3, 3). distance_m: (N,), along the beam. flow_mps: (N, 3), distance times flow, in
    odom axes, across the beam. turn_mps: (N, 3), the part of it that turns explain, with the lever arm; rate_mps: (N, 3),
    without it. noise_mps: (N,), rms of a component. valid: (N,).
    """

    instants_s: FloatArray
    odom_from_body: FloatArray
    distance_m: FloatArray
    flow_mps: FloatArray
    turn_mps: FloatArray
    rate_mps: FloatArray
    noise_mps: FloatArray
    valid: BoolArray

    def velocities_mps(self, scale: float) -> FloatArray:
        """Return velocities (N, 3) of the body's origin across the beam, odom axes.

        scale: by which the flow is too large.
        """
        return self.flow_mps / scale - self.turn_mps

    def selected(self, which: BoolArray) -> FlowSamples:
        """Return some of the samples."""
        return FlowSamples(
            self.instants_s[which],
            self.odom_from_body[which],
            self.distance_m[which],
            self.flow_mps[which],
            self.turn_mps[which],
            self.rate_mps[which],
            self.noise_mps[which],
            self.valid[which],
        )


def flow_samples(
    instants_s: FloatArray,
    rates_radps: FloatArray,
    flow_radps: FloatArray,
    quality: FloatArray,
    odom_from_body: FloatArray,
    surface: SurfaceHeight,
    geometry: FlowGeometry,
    scale: float,
) -> FlowSamples:
    """Return the samples of readings in the order of time.

    instants_s: (N,), middle of the intervals. rates_radps: (N, 3), turn rates of the body. flow_radps: (N, 2). quality: (N,).
    odom_from_body: rotations (N, 3, 3).
    """
    up_body = odom_from_body[:, 2, :]
    height_m, known = surface.at(instants_s)
    level = np.maximum(up_body[:, 2], 0.1)
    distance_m = (height_m + up_body @ geometry.flow_m) / level
    across = np.stack([-flow_radps[:, 1], flow_radps[:, 0]], axis=1) * distance_m[:, None]
    turning = np.stack([-rates_radps[:, 1], rates_radps[:, 0]], axis=1) * distance_m[:, None]
    x, y, z = geometry.flow_m.tolist()
    lever = np.stack([rates_radps[:, 1] * z - rates_radps[:, 2] * y, rates_radps[:, 2] * x - rates_radps[:, 0] * z], axis=1)
    along_x_y = odom_from_body[:, :, :2]
    valid = known & (up_body[:, 2] >= _MOST_TILTED_FACTOR) & (distance_m >= _NEAREST_M) & (distance_m <= _FARTHEST_M)
    valid &= (quality >= LEAST_QUALITY_FACTOR) & (np.abs(flow_radps).max(axis=1, initial=0.0) <= _FASTEST_RADPS)
    valid &= ~_frozen(flow_radps, rates_radps)
    samples = FlowSamples(
        instants_s=instants_s,
        odom_from_body=odom_from_body,
        distance_m=distance_m,
        flow_mps=_turned(along_x_y, across),
        turn_mps=_turned(along_x_y, turning + lever),
        rate_mps=_turned(along_x_y, turning),
        noise_mps=np.maximum(
            _NOISE_RADPS * distance_m * _GOOD_QUALITY / np.clip(quality, 0.1, _GOOD_QUALITY), _LEAST_NOISE_MPS
        ),
        valid=valid,
    )
    return _without_jumps(_near_steps(samples, surface, scale), scale)


def _turned(along_x_y: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return vectors (N, 2) across the beam in odom axes (N, 3)."""
    return np.asarray((along_x_y @ vectors[:, :, None])[:, :, 0])


def _frozen(flow_radps: FloatArray, rates_radps: FloatArray) -> BoolArray:
    """Return which readings (N,) are equal, in a run over which the turn rate changes."""
    equal = np.concatenate(([False], np.all(flow_radps[1:] == flow_radps[:-1], axis=1)))[: len(flow_radps)]
    frozen = np.zeros(len(equal), dtype=bool)
    starts = np.nonzero(~equal)[0].tolist()
    for start, end in zip(starts, [*starts[1:], len(equal)], strict=True):
        if end - start >= _EQUAL and np.ptp(rates_radps[start:end, :2], axis=0).max() > _TURNING_RADPS:
            frozen[start:end] = True
    return frozen


def _near_steps(samples: FlowSamples, surface: SurfaceHeight, scale: float) -> FlowSamples:
    """Return the samples without those beside a step of the range.

    A little farther from it they have more noise.
    """
    speed_mps = np.linalg.norm(samples.velocities_mps(scale), axis=1)
    noise_mps, valid = samples.noise_mps.copy(), samples.valid.copy()
    for step_s, size in zip(surface.step_times_s().tolist(), surface.step_sizes().tolist(), strict=True):
        apart_s = np.abs(samples.instants_s - step_s)
        valid &= apart_s > _STEP_REJECT_S
        noise_mps = np.hypot(noise_mps, _STEP_SHARE * size * speed_mps * np.maximum(1.0 - apart_s / _STEP_FADE_S, 0.0))
    return replace(samples, noise_mps=noise_mps, valid=valid)


def _without_jumps(samples: FlowSamples, scale: float) -> FlowSamples:
    """Return the samples without those that differ from the median of their neighbours.

    Noise that the samples show counts where it is larger.
    """
    (at,) = np.nonzero(samples.valid)
    if len(at) < _NEIGHBOURS:
        return samples
    velocity_mps, noise_mps = samples.velocities_mps(scale)[at], samples.noise_mps.copy()
    noise_mps[at] = np.maximum(noise_mps[at], _shown_noise_mps(velocity_mps))
    half = _NEIGHBOURS // 2
    padded = np.concatenate([velocity_mps[:1]] * half + [velocity_mps] + [velocity_mps[-1:]] * half)
    windows = np.lib.stride_tricks.sliding_window_view(padded, _NEIGHBOURS, axis=0)
    away_mps = np.linalg.norm(velocity_mps - np.median(windows, axis=-1), axis=1)
    valid = samples.valid.copy()
    valid[at] = away_mps <= _JUMP_SIGMAS * noise_mps[at] + _JUMP_MPS
    return replace(samples, noise_mps=noise_mps, valid=valid)


def _shown_noise_mps(velocity_mps: FloatArray) -> float:
    """Return the rms noise that velocities (N, 3) show.

    It follows from how far each is off the mean of its two neighbours.
    """
    off_mps = velocity_mps[1:-1] - (velocity_mps[:-2] + velocity_mps[2:]) / 2.0
    return float(np.median(np.linalg.norm(off_mps, axis=1))) / (_MEDIAN_OF_PLANE * math.sqrt(1.5))
