"""Colour image of a kept view, compressed.

The rays of the view get their colours again when errors of the camera become better known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uav_recon.mapping.neural.keyframes.colour_projection import ColourImager
from uav_recon.types.camera import Frame
from uav_recon.types.camera_calibration import CameraMotion
from uav_recon.types.frames import AnyArray, ByteArray, FloatArray
from uav_recon.types.pose import Pose

JPEG_QUALITY = 95


@dataclass(frozen=True, slots=True, eq=False)
class ColourImage:
    """A JPEG (N,) uint8 of the nominal colour imager.

    lens (4,): fx, fy, cx, cy; width_px: of the image.
    """

    jpeg: AnyArray
    lens: FloatArray
    width_px: int
    rgb_from_depth: Pose

    @staticmethod
    def of(frame: Frame) -> ColourImage:
        """Compress the colour image of a frame: about 1 ms for 424 x 240 pixels."""
        import cv2

        _, jpeg = cv2.imencode(".jpg", np.ascontiguousarray(frame.rgb[:, :, ::-1]), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        lens = frame.rgb_intrinsics
        return ColourImage(np.asarray(jpeg).ravel(), lens.pinhole_px(), lens.width, frame.rgb_from_depth)

    def without_pixels(self) -> ColourImage:
        """Return the same for a state that stores the JPEG apart."""
        return replace(self, jpeg=np.zeros(0, dtype=np.uint8))

    def decoded(self) -> ByteArray:
        """Return the image (h, w, 3). Raises ValueError if the JPEG is damaged."""
        import cv2

        bgr = cv2.imdecode(self.jpeg, cv2.IMREAD_COLOR) if self.jpeg.size else None
        if bgr is None:
            raise ValueError("the colour image of a view is damaged")
        return np.ascontiguousarray(bgr[:, :, ::-1])

    def imager(self, motion: CameraMotion, width_px: int | None = None) -> ColourImager:
        """Return the imager for kernels; motion: of the depth imager. width_px: of a reduced image."""
        factor = 1.0 if width_px is None else width_px / self.width_px
        fx, fy, cx, cy = self.lens
        turn = motion.odom_from_depth.rotation().T
        return ColourImager(
            np.array([fx * factor, fy * factor, (cx + 0.5) * factor - 0.5, (cy + 0.5) * factor - 0.5]),
            self.rgb_from_depth.rotation(),
            self.rgb_from_depth.translation_m,
            turn @ motion.velocity_mps,
            turn @ motion.rate_radps,
        )
