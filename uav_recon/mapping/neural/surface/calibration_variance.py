"""Variance of the surface that the errors of the camera leave.

More measurements do not reduce it: all views of a surface share these errors. What they shift it by is the mean derivative of
its measurements by the errors (geometry.camera_error_row), stored in space, times the errors.
"""

from __future__ import annotations

import numpy as np

from uav_recon.geometry.camera_error_row import error_row
from uav_recon.geometry.jit import kernel
from uav_recon.mapping.neural.surface.uncertainty import Lattice, MeasuredAgreement
from uav_recon.types.camera_calibration import ERROR_SIGMAS, CameraMotion
from uav_recon.types.frames import Float32Array, FloatArray

CELL_M = 0.15
STRIDE = 4  # every STRIDE-th measurement is used: many fall into one cell
ELEMENTS = len(ERROR_SIGMAS)
DOUBLING_SIGMA_M = 0.7  # sigma of a surface that adds 1 to the agreement, which is without unit


class CalibrationVariance:
    """Variance of surface points along their normal.

    covariance (9, 9): of the errors of the camera, in the order of camera_error_row; zero until all views show them.
    """

    def __init__(self, box_min_m: FloatArray, box_max_m: FloatArray) -> None:
        self._lattice = Lattice(box_min_m, box_max_m, CELL_M, ELEMENTS + 1)  # sum of derivatives, number
        self.covariance: FloatArray = np.zeros((ELEMENTS, ELEMENTS))

    def add(self, points: Float32Array, normal: Float32Array, motion: CameraMotion) -> None:
        """Add the end points (N, 3) of a view, with normals (N, 3), zero where not known."""
        points, normal = points[::STRIDE].copy(), normal[::STRIDE].copy()
        rows = np.zeros((len(points), ELEMENTS + 1), dtype=np.float32)
        here = motion.odom_from_depth
        _derive(points, normal, here.rotation(), here.translation_m, motion.velocity_mps, motion.rate_radps, rows)
        self._lattice.splat(points, rows)

    def clear(self) -> None:
        """Forget all measurements."""
        self._lattice.clear()

    def at(self, points: Float32Array) -> Float32Array:
        """Return the variance (N,) in square metres, zero where nothing was measured."""
        variance = np.empty(len(points), dtype=np.float32)
        _project(self._lattice.at(points), self.covariance, variance)
        return variance


class CalibratedAgreement:
    """The measured agreement, and the variance that the errors of the camera leave."""

    def __init__(self, agreement: MeasuredAgreement, calibration: CalibrationVariance) -> None:
        self._agreement = agreement
        self._calibration = calibration

    def at(self, points: Float32Array) -> Float32Array:
        """Return positive numbers (N,), largest where nothing was measured."""
        return self._agreement.at(points) + self._calibration.at(points) / np.float32(DOUBLING_SIGMA_M**2)


@kernel
def _project(rows: Float32Array, covariance: FloatArray, variance: Float32Array) -> None:
    """Compute the variance (N,) of errors with a covariance (9, 9) along mean derivatives.

    rows (N, 10): sum of derivatives, number. Not by a matrix product: its rounding of a row depends on the number of rows, and
    a part of the surface would differ from the same part of the whole.
    """
    for n in range(rows.shape[0]):
        total = 0.0
        for i in range(ELEMENTS):
            for j in range(ELEMENTS):
                total += rows[n, i] * covariance[i, j] * rows[n, j]
        variance[n] = total / max(np.float64(rows[n, ELEMENTS]), 1e-6) ** 2


@kernel
def _derive(
    points: Float32Array, normal: Float32Array, rotation: FloatArray, place: FloatArray, velocity: FloatArray, rate: FloatArray,
    rows: Float32Array,
) -> None:  # fmt: skip
    """Compute the derivatives of measurements by the errors of the camera, and 1.

    Nothing without a normal.
    """
    for n in range(points.shape[0]):
        if normal[n, 0] != 0.0 or normal[n, 1] != 0.0 or normal[n, 2] != 0.0:
            rows[n, :9] = error_row(normal[n], points[n], rotation, place, velocity, rate)
            rows[n, 9] = 1.0
