"""Normals predicted from the colour image, by an optional ONNX model, for rays without one.

Input: one float32 tensor (1, 3, h, w), RGB in 0..1. A model with free h and w gets the original image size; for any other
the image is resized. Output: one float32 tensor, either

- (1, 3, h, w) normals in the colour camera's axes (x right, y down, z forward), towards the camera; components in -1..1, or
  all in 0..1 for (n + 1) / 2, as Omnidata (Eftekhar et al. 2021) returns them; or
- (1, 1, h, w) or (1, h, w) depth along the optical axis or its inverse, up to scale and shift (Ranftl et al. 2022): both
  interpretations are fitted to the measured depth, the better one is used, and normals are computed from its slopes.

Measured normals are never replaced. An image whose predicted normals disagree with the measured ones is not used.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np

from uav_recon.mapping.neural.keyframes.ray_records import BEARING_UNIT, DEPTH_FARTHEST_M, DEPTH_UNIT_M, NORMAL_UNIT
from uav_recon.types.camera import Frame, Intrinsics
from uav_recon.types.frames import AnyArray, BoolArray, ByteArray, Float32Array, FloatArray, IntArray

LOG = logging.getLogger(__name__)

PROVIDERS = ("TensorrtExecutionProvider", "CUDAExecutionProvider", "CPUExecutionProvider")  # in order of preference
TRIAL = 64  # side in pixels of the test image for a model with free size
FEWEST = 50  # minimum number of measured normals or depths for a comparison
AGREEING_COSINE = 0.8  # minimum median: 37°
LENGTH_ERROR = 0.5  # maximum error of the length of a normal
MIN_FACING = 0.05  # a normal seen at a flatter angle is not used


class PriorError(Exception):
    """Raised for a model that cannot be used; the text is one line with its path."""


class NormalPrior:
    """One model. refused: number of images for which it was not used.

    The constructor raises PriorError if the file is missing, is no ONNX model, or has other inputs or outputs.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        if not path.is_file():
            raise PriorError(f"mapper.prior_model {path}: no such file")
        runtime = _runtime(path)
        options = runtime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1  # the same sums in the same order
        options.log_severity_level = 4
        providers = [name for name in PROVIDERS if name in runtime.get_available_providers()]
        try:
            self._session = runtime.InferenceSession(str(path), options, providers=providers)
        except Exception as error:  # the exceptions of onnxruntime have no other common base
            raise PriorError(f"mapper.prior_model {path}: not an ONNX model that runs here ({_line(error)})") from None
        self._input, self._size = self._checked_input()
        self.refused = 0
        self._run(np.full((*(side or TRIAL for side in self._size), 3), 128, dtype=np.uint8))

    def fill(self, records: AnyArray, frame: Frame) -> int:
        """Add normals to the records (N, COLUMNS) of a frame that have none; returns their number."""
        lens, to_rgb = frame.rgb_intrinsics, frame.rgb_from_depth
        measured: FloatArray = records[:, 3:6] * NORMAL_UNIT
        known = measured.any(axis=1)
        bearing = np.concatenate([records[:, :2] * BEARING_UNIT, np.ones((len(records), 1))], axis=1)
        points = to_rgb.apply(bearing * (records[:, 2:3] * DEPTH_UNIT_M))
        try:
            answer = self._run(frame.rgb)
        except PriorError as error:  # a model with free size that cannot process this size
            self._refuse(str(error))
            return 0
        pixel, shown = _pixels(points, lens, answer.shape[1:])
        if shown.sum() < FEWEST:
            return 0
        normals = _unit(answer) if len(answer) == 3 else _slopes(answer[0], lens, pixel[shown], points[shown, 2])
        found = normals[pixel[:, 0], pixel[:, 1]] @ to_rgb.rotation()  # depth_from_rgb
        facing = -np.einsum("nc,nc->n", found, bearing) / np.linalg.norm(bearing, axis=1)
        both = known & shown
        agreement = np.einsum("nc,nc->n", found[both], measured[both])
        if both.sum() >= FEWEST and np.median(agreement) < AGREEING_COSINE:
            degrees = np.rad2deg(np.arccos(np.median(agreement)))
            self._refuse(f"mapper.prior_model {self._path}: its normals are at a median of {degrees:.0f}° to the measured ones")
            return 0
        wanted = shown & ~known & (facing > MIN_FACING)
        records[wanted, 3:6] = np.rint(found[wanted] / NORMAL_UNIT)
        return int(wanted.sum())

    def _refuse(self, why: str) -> None:
        self.refused += 1
        if self.refused & (self.refused - 1) == 0:
            LOG.warning("%s; so it taught nothing (%d pictures so far)", why, self.refused)

    def _checked_input(self) -> tuple[str, tuple[int | None, int | None]]:
        inputs = self._session.get_inputs()
        shape = inputs[0].shape if inputs else []
        fits = len(inputs) == 1 and len(shape) == 4 and inputs[0].type == "tensor(float)"
        if not fits or (isinstance(shape[0], int) and shape[0] != 1) or (isinstance(shape[1], int) and shape[1] != 3):
            wants = ", ".join(f"{i.type} {i.shape}" for i in inputs)
            raise PriorError(f"mapper.prior_model {self._path}: wants {wants}, not one tensor(float) [1, 3, h, w]")
        height, width = (side if isinstance(side, int) else None for side in shape[2:])
        return inputs[0].name, (height, width)

    def _run(self, rgb: ByteArray) -> Float32Array:
        """Run the model on an image: (3, h, w) normals or (1, h, w) depth, not finite if unknown.

        Raises PriorError if the model fails or returns something else.
        """
        import cv2

        height, width = (want or have for want, have in zip(self._size, rgb.shape[:2], strict=True))
        picture = cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA) if (height, width) != rgb.shape[:2] else rgb
        tensor = np.ascontiguousarray(picture.transpose(2, 0, 1)[None].astype(np.float32) / np.float32(255.0))
        try:
            answers = self._session.run(None, {self._input: tensor})
        except Exception as error:  # the exceptions of onnxruntime have no other common base
            raise PriorError(
                f"mapper.prior_model {self._path}: fails on a picture of {width}x{height} ({_line(error)})"
            ) from None
        answer = np.asarray(answers[0])
        if answer.ndim == 3:
            answer = answer[:, None]
        if len(answers) != 1 or answer.dtype != np.float32 or answer.ndim != 4 or answer.shape[:2] not in ((1, 3), (1, 1)):
            gives = ", ".join(f"{np.asarray(a).dtype} {list(np.shape(a))}" for a in answers)
            raise PriorError(f"mapper.prior_model {self._path}: gives {gives}, not one float32 [1, 3, h, w] or [1, 1, h, w]")
        first: Float32Array = answer[0]
        return first


def open_prior(path: Path | None) -> NormalPrior | None:
    """Return the model at a path; None without a path. Raises PriorError."""
    return None if path is None else NormalPrior(path)


def _runtime(path: Path) -> Any:
    try:
        import onnxruntime
    except ImportError as error:
        raise PriorError(f"mapper.prior_model {path}: pip install uav-recon[priors] ({error})") from None
    return onnxruntime


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]


def _pixels(points: FloatArray, lens: Intrinsics, shape: tuple[int, ...]) -> tuple[IntArray, BoolArray]:
    """Return the pixels (N, 2) of points (N, 3), and a mask of the visible points (N,).

    Pixels are (row, column). points: in the camera frame. shape (h, w): size of the image.
    """
    z = np.maximum(points[:, 2], 1e-3)
    u, v = points[:, 0] / z * lens.fx + lens.cx, points[:, 1] / z * lens.fy + lens.cy
    shown = (points[:, 2] > 0.05) & (u > -0.5) & (v > -0.5) & (u < lens.width - 0.5) & (v < lens.height - 0.5)
    scale = np.array([shape[0] / lens.height, shape[1] / lens.width])
    pixel = np.floor((np.stack([v, u], axis=1) + 0.5) * scale)
    return np.clip(pixel, 0, np.array(shape) - 1).astype(np.int64), shown


def _unit(answer: Float32Array) -> FloatArray:
    """Return unit normals (h, w, 3) from (3, h, w), zero where there is none."""
    normals = answer.astype(np.float64).transpose(1, 2, 0)
    finite = np.isfinite(normals).all(axis=2, keepdims=True)
    normals = np.where(finite, normals, 0.0)
    if normals.min() >= 0.0 and normals.max() <= 1.0:  # a normal towards the camera never has z above 0
        normals = 2.0 * normals - 1.0
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    return np.where(finite & (np.abs(length - 1.0) < LENGTH_ERROR), normals / np.maximum(length, LENGTH_ERROR), 0.0)


def _slopes(answer: Float32Array, lens: Intrinsics, pixel: IntArray, z_m: FloatArray) -> FloatArray:
    """Return normals (h, w, 3) from a relative depth (h, w); zero where unknown.

    z_m (N,): measured depth at pixels (N, 2).
    """
    answered = np.where(np.isfinite(answer), answer.astype(np.float64), np.nan)
    at = answered[pixel[:, 0], pixel[:, 1]]
    finite = np.isfinite(at)
    if finite.sum() < FEWEST:
        return np.zeros((*answered.shape, 3))
    at, pixel, z_m = at[finite], pixel[finite], z_m[finite]
    depth = _fitted(answered, at, z_m)
    inverse = 1.0 / np.maximum(_fitted(answered, at, 1.0 / z_m), 1.0 / (2.0 * DEPTH_FARTHEST_M))
    error = [np.median(np.abs(way[pixel[:, 0], pixel[:, 1]] - z_m)) for way in (depth, inverse)]
    z = depth if error[0] < error[1] else inverse
    rows, columns = np.indices(answered.shape)
    x = ((columns + 0.5) * lens.width / answered.shape[1] - 0.5 - lens.cx) / lens.fx * z
    y = ((rows + 0.5) * lens.height / answered.shape[0] - 0.5 - lens.cy) / lens.fy * z
    down, right = np.gradient(np.stack([x, y, z], axis=2), axis=(0, 1))
    normal = np.cross(down, right)  # y cross x is -z: towards the camera
    length = np.linalg.norm(normal, axis=2, keepdims=True)
    return np.where((length > 0.0) & (z > 0.0)[:, :, None], normal / np.maximum(length, 1e-12), 0.0)


def _fitted(answered: FloatArray, at: FloatArray, target: FloatArray) -> FloatArray:
    """Return scale * answered + shift, fitted so that ``at`` (N,) matches ``target`` (N,).

    The second of two fits uses the better half of the points only.
    """
    use = np.ones(len(at), dtype=np.bool_)
    for _ in range(2):
        (scale, shift), *_ = np.linalg.lstsq(np.stack([at[use], np.ones(use.sum())], axis=1), target[use], rcond=None)
        error = np.abs(scale * at + shift - target)
        use = error <= np.median(error)
    fitted: FloatArray = scale * answered + shift
    return fitted
