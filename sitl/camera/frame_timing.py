"""Times of exposure of the frames of a flight, and bursts of lost frames."""

from __future__ import annotations

import numpy as np

from sitl.camera.camera_errors import JITTER_SIGMAS, CameraErrors
from sitl.camera.frame_exposure import ExposureTimes

_JITTER_STREAM = 0x717E
_LOSS_STREAM = 0x1055


class FrameTiming:
    """Exposure times of successive frames with the timing errors of a flight.

    Repeatable for a seed.
    """

    def __init__(self, errors: CameraErrors) -> None:
        self._errors = errors.timing
        self._rng = np.random.default_rng([errors.seed, _JITTER_STREAM])

    def exposure(self, stamp_s: float) -> ExposureTimes:
        """Return the times of the next frame, whose stamp is stamp_s."""
        e = self._errors
        jitter_s = e.jitter_s * min(max(float(self._rng.standard_normal()), -JITTER_SIGMAS), JITTER_SIGMAS)
        depth_s = stamp_s - (e.age_s + jitter_s)
        middle_s, half_s = depth_s + e.colour_delay_s, 0.5 * e.readout_s
        return ExposureTimes(stamp_s, depth_s, middle_s - half_s, middle_s + half_s)


class FrameLoss:
    """Bursts of lost frames, the first one a gap after the first frame. Repeatable for a seed."""

    def __init__(self, errors: CameraErrors) -> None:
        self._errors = errors.loss
        self._rng = np.random.default_rng([errors.seed, _LOSS_STREAM])
        self._next_s: float | None = None
        self._left = 0

    def lost(self, stamp_s: float) -> bool:
        """Return True if the frame of stamp_s is lost; call it once per frame."""
        if self._errors.max_frames == 0:
            return False
        if self._next_s is None:
            self._next_s = stamp_s + self._gap_s()
        if stamp_s >= self._next_s:
            self._next_s = stamp_s + self._gap_s()
            self._left = int(self._rng.integers(1, self._errors.max_frames, endpoint=True))
        self._left -= 1
        return self._left >= 0

    def _gap_s(self) -> float:
        return float(self._rng.uniform(self._errors.min_gap_s, self._errors.max_gap_s))
