"""Odometry health, from age and rate of the poses and their agreement with the IMU."""

from __future__ import annotations

import math
from collections import deque

from uav_recon.types.pose import PoseHealth
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_USUAL_S = 1.0 / 15.0  #: internal: usual interval of poses
_SLOWER_S = 0.2  #: hold: _LATE_S and _SILENT_S are longer by at most this where poses come less often than usual
_LATE_S = 0.20  #: hold: the newest pose is older: the vehicle stops while its velocity is known
_SILENT_S = 0.25  #: hold: the newest pose is older: it counts as lost, and pose_timeout_s and pose_land_s run
_WINDOW_S = 1.0  #: internal: time over which the rate of poses is measured
_FEW_HZ = 8.0  #: brake: retreat_speed_mps while fewer poses come
_TOO_FEW_HZ = 4.0  #: hold: fewer poses come: they count as lost; EKF2 diverges at 2 to 5 poses a second (hazard B10)
_MAX_MEAN_NIS = 15.0  #: brake: retreat_speed_mps above this mean of the newest squared innovations, whose expected value is six
_SURPRISES = 10  #: brake: number of innovations in that mean: one alone may be an outlier
_DEGRADED_QUALITY = 60  # quality that the autopilot gets at most, with a degraded pose
#: reject: quality that the autopilot gets with a lost pose: it refuses below this (EKF2_EV_QMIN, VISO_QUAL_MIN)
_LOST_QUALITY = 20


def most_quality(health: PoseHealth) -> int:
    """Return the highest quality that the autopilot gets with a pose of this health."""
    return {PoseHealth.GOOD: 100, PoseHealth.DEGRADED: _DEGRADED_QUALITY, PoseHealth.LOST: _LOST_QUALITY}[health]


class OdometryHealthMonitor:
    """Monitors one filter: fused() for each fused pose; health() and quality() at any instant."""

    def __init__(self, pose_lost_s: float) -> None:
        self._lost_s = pose_lost_s
        self._stamps_s: deque[float] = deque()
        self._surprises: deque[float] = deque(maxlen=_SURPRISES)
        self._since_s = math.inf

    def begin(self, stamp_s: float) -> None:
        """Restart with the filter."""
        self._stamps_s.clear()
        self._surprises.clear()
        self._since_s = stamp_s

    def fused(self, stamp_s: float, nis: float) -> None:
        """Record a fused pose with its normalized innovation squared."""
        self._stamps_s.append(stamp_s)
        self._surprises.append(min(nis, 10.0 * _MAX_MEAN_NIS))
        while self._stamps_s[0] <= stamp_s - _WINDOW_S:
            self._stamps_s.popleft()

    def health(self, age_s: float, imu_fault: Reason | None, on_trial: bool) -> tuple[PoseHealth, Reason | None]:
        """Return the health and the reason, None for nothing.

        age_s: of the newest pose. imu_fault: why not all of the IMU is used. on_trial: poses arrive, but are not accepted.
        """
        rate_hz = self._rate_hz()
        slower_s = min(max(1.0 / rate_hz - _USUAL_S, 0.0), _SLOWER_S)
        late = Reason(ReasonCode.POSES_DISAGREE if on_trial else ReasonCode.NO_POSE, (age_s,))
        few = Reason(ReasonCode.FEW_POSES, (rate_hz,))
        mean = sum(self._surprises) / max(len(self._surprises), 1)
        surprised = len(self._surprises) == _SURPRISES and mean > _MAX_MEAN_NIS
        checks = (
            (age_s > min(_SILENT_S + slower_s, self._lost_s), PoseHealth.LOST, late),
            (rate_hz < _TOO_FEW_HZ, PoseHealth.LOST, few),
            (on_trial or age_s > _LATE_S + slower_s, PoseHealth.DEGRADED, late),
            (rate_hz < _FEW_HZ, PoseHealth.DEGRADED, few),
            (imu_fault is not None, PoseHealth.DEGRADED, imu_fault),
            (surprised, PoseHealth.DEGRADED, Reason(ReasonCode.IMU_DISAGREES, (mean,))),
        )
        return next(((health, reason) for fails, health, reason in checks if fails), (PoseHealth.GOOD, None))

    def quality(self, health: PoseHealth, age_s: float, source: int) -> int:
        """Return the quality from 0 to 100: the lower of the source's and the health's.

        The source's falls to 0 between 40 % and 100 % of the time until the pose counts as lost.
        """
        share = min(1.0, max(0.0, (self._lost_s - age_s) / (0.6 * self._lost_s)))
        return min(most_quality(health), math.ceil(source * share))

    def _rate_hz(self) -> float:
        """Return the rate of the poses of the newest second; the usual rate in the first second."""
        if not self._stamps_s or self._stamps_s[-1] - self._since_s < _WINDOW_S:
            return 1.0 / _USUAL_S
        intervals, span_s = len(self._stamps_s) - 1, self._stamps_s[-1] - self._stamps_s[0]
        return intervals / span_s if intervals else 1.0 / _WINDOW_S
