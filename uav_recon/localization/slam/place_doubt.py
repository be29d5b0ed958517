"""Doubt of the place: when the track does not know it, and when a pose is given.

What is found wrong afterwards leaves the poses little by little.
"""

from __future__ import annotations

import math

import numpy as np

from uav_recon.types.frames import FloatArray
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

LONG_WAY_BACK_S = 5.0  #: reject: the time of the way back while another source knows the motion
_WAY_BACK_S = 3.0  #: reject: time of the way back, after the newest pose that was sure
_MOST_SIGMA_M = 0.12  #: reject: no pose is given while the place is more uncertain than this in a direction
_MOST_ON_WAY_BACK_M = 0.35  #: reject: the same on the way back: a blind landing would drift farther
#: retreat: the place has become more uncertain than this in a direction: back to a view in which it was not
_DOUBT_M = 0.08
_DRIFT_MPS = 0.004  # growth of the uncertainty with the flight, which no way back reduces
_BLIND_M = 0.04  #: retreat: the place is more uncertain than this against the track: the view has not shown it for 0.6 s
_LEFT_M = 0.05  #: retreat: while more than this of a found error is not yet in the poses; not tuned
_SURE_AGAIN_SHARE = 0.85  #: retreat: until both are less than this share of their limits
# a found error is taken out of the poses at this speed: faster, they would contradict the inertial samples of the autopilot
_RELEASE_MPS = 0.1


class PlaceDoubt:
    """Doubt of one track. Not thread-safe.

    ``unsure``: the newest accepted frame has not shown the place. ``unreleased_m`` (3,): found error of the place that is still
    in the poses.
    """

    def __init__(self) -> None:
        self.unsure = False
        self.unreleased_m = np.zeros(3)
        self._sure_s = -math.inf
        self._judged_s = math.inf
        self._drifted_m = 0.0  # standard deviation of the place by the drift of the flight

    def judge(self, stamp_s: float, sigma_m: float, against_track_m: float) -> None:
        """Take an accepted frame.

        sigma_m: standard deviation of its place in the worst direction; against_track_m: the same against the track.
        """
        limit = _SURE_AGAIN_SHARE if self.unsure else 1.0
        self._drifted_m = min(self._drifted_m + _DRIFT_MPS * max(stamp_s - self._judged_s, 0.0), sigma_m)
        self._judged_s = stamp_s
        lately_m = math.sqrt(sigma_m**2 - self._drifted_m**2)
        self.unsure = lately_m > limit * _DOUBT_M or against_track_m > limit * _BLIND_M
        self._sure_s = self._sure_s if self.unsure else stamp_s

    def allows(self, stamp_s: float, sigma_m: float, *, moved_outside: bool) -> bool:
        """Return True if a pose may be given. moved_outside: another source knows the motion."""
        way_back_s = LONG_WAY_BACK_S if moved_outside else _WAY_BACK_S
        return sigma_m <= (_MOST_ON_WAY_BACK_M if stamp_s - self._sure_s <= way_back_s else _MOST_SIGMA_M)

    def found(self, error_m: FloatArray, step_s: float) -> None:
        """Take a found error (3,) of the place into the poses, little by little.

        step_s: since the frame before.
        """
        left_m = self.unreleased_m - error_m
        length_m = float(np.linalg.norm(left_m))
        self.unreleased_m = left_m * max(1.0 - _RELEASE_MPS * step_s / max(length_m, 1e-9), 0.0)

    def drop(self) -> None:
        """Take all of a found error at once: there is no pose that would jump."""
        self.unreleased_m = np.zeros(3)

    def quality(self, quality: float, sigma_m: float) -> int:
        """Return the quality, 1 to 100, of a pose; less the more uncertain its place is."""
        return max(round(quality * min(_DOUBT_M / sigma_m, 1.0)), 1)

    def reason(self, sigma_m: float) -> Reason | None:
        """Return why a pose is degraded; None if it is good."""
        left_m = float(np.linalg.norm(self.unreleased_m))
        if not self.unsure and left_m <= _LEFT_M:
            return None
        return Reason(ReasonCode.PLACE_UNSURE, (math.hypot(sigma_m, left_m),))
