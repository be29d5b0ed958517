"""A depth camera whose known delay and depth scale are corrected in its frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from uav_recon.interfaces import DepthCamera
from uav_recon.types.camera import Frame, ImuSample


class CorrectedCamera:
    """Camera protocol around another one.

    delay_s: frames are older than their stamp by this. depth_scale: share by which depths are too large. Both as calibrated;
    what is left of them is estimated in flight.
    """

    def __init__(self, camera: DepthCamera, delay_s: float, depth_scale: float) -> None:
        self._camera = camera
        self._delay_s = delay_s
        self._depth_scale = depth_scale

    def poll(self) -> Frame | None:
        """Return the newest frame that was not returned before, corrected, or None."""
        frame = self._camera.poll()
        if frame is None:
            return None
        depth_m = frame.depth_m if self._depth_scale == 0.0 else frame.depth_m / np.float32(1.0 + self._depth_scale)
        return replace(frame, stamp_s=frame.stamp_s - self._delay_s, depth_m=depth_m)

    def imu(self) -> list[ImuSample]:
        """Return the inertial samples since the last call, unchanged."""
        return self._camera.imu()

    def close(self) -> None:
        """Release the device."""
        self._camera.close()
