"""Inertial samples of the camera, or in their place the turn rates of the autopilot's gyro.

Many companions see no IMU of the camera (JetPack 6), and one that works may freeze. The autopilot's gyro is on the same body.
Its accelerometer is not used: the filter without one is as good as the poses.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable

import numpy as np

from uav_recon.interfaces import Channel
from uav_recon.localization.fusion.imu_sample_gate import ImuSampleGate
from uav_recon.types.camera import ImuSample
from uav_recon.types.vehicle import TurnRates

_ABSENT_S = 0.5  #: reject: the camera's inertial samples after a longer silence, where the autopilot's gyro is there instead
_FRESH_S = 0.3  #: reject: the autopilot's turn rates if the newest is older

_NO_FORCE = np.full(3, math.nan)


class InertialSelection:
    """The inertial samples of one moment, from the source that works.

    camera: gives the camera's samples since the last call. autopilot: its newest turn rates; None if nobody reports them.
    """

    def __init__(self, camera: Callable[[], list[ImuSample]], autopilot: Channel[TurnRates] | None) -> None:
        self._camera = camera
        self._autopilot = autopilot
        self._health = ImuSampleGate(Counter())
        self._heard_s = -math.inf  # when the camera last sent samples
        self._used_s = -math.inf  # stamp of the newest turn rate that was read

    def samples(self, now_s: Callable[[], float]) -> list[ImuSample]:
        """Return the samples since the last call, oldest first.

        Samples of the autopilot have a specific force of NaN. now_s: read after the samples, so none lies in the future.
        """
        camera = self._camera()
        at_s = now_s()
        if camera or math.isinf(self._heard_s):
            self._heard_s = at_s
        self._health.admit(camera, at_s)
        rates = self._new_rates(at_s)
        works = at_s - self._heard_s <= _ABSENT_S and not self._health.gyro_frozen
        return camera if works or at_s - self._used_s > _FRESH_S else rates

    def _new_rates(self, now_s: float) -> list[ImuSample]:
        """Return the autopilot's turn rates that were not read yet."""
        newest = None if self._autopilot is None else self._autopilot.latest()
        if newest is None or len(newest.stamps_s) != len(newest.rates_radps):
            return []
        stamps_s = newest.stamps_s.tolist()
        fresh = [k for k, stamp_s in enumerate(stamps_s) if self._used_s < stamp_s <= now_s]
        if fresh:
            self._used_s = stamps_s[fresh[-1]]
        return [ImuSample(stamps_s[k], newest.rates_radps[k], _NO_FORCE) for k in fresh]
