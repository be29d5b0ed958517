"""Kept calibration: the errors of the camera that one flight leaves to the next.

A flight begins from what the last one with this camera has observed, less sure of it. It writes what it has observed itself,
from time to time and once the camera stands at rest after a motion. A flight whose odometry was found wrong writes nothing
more, and what was learned in the last seconds before is not written either. A file of something else is never replaced.
"""

from __future__ import annotations

import hashlib
import json
import logging
from pathlib import Path

from uav_recon import atomic_file
from uav_recon.interfaces import Executor, Pending
from uav_recon.localization.calibration.calibration_filter import CalibrationFilter, Elements, kept_fault, observed
from uav_recon.types.camera import Frame
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

_FORMAT = 1
_PROVEN_S = 30.0  #: internal: what was learned is written this time later, if odometry was valid until then
_WRITE_COST_S = 0.01  # declared cost of a write on a simulated clock
_LOG = logging.getLogger(__name__)


class ForeignFileError(ValueError):
    """A file that is not a calibration file: never replaced."""


class KeptCalibration:
    """The file of one camera. Reads it at once; writes beside the control loop. Not thread-safe.

    file: read by the next flight. mount: text that says how the camera is mounted; with the intrinsics it tells one camera from
    another. executor: runs the writes. ``reason``: None, or that the file is used, or why it is not.
    """

    def __init__(self, file: Path, mount: str, executor: Executor) -> None:
        self._file = file
        self._mount = mount
        self._executor = executor
        self._camera = ""
        self._pending: Pending[None] | None = None
        self._waiting: tuple[float, Elements] | None = None
        self._moved = self._wrong = self._foreign = False
        self.reason: Reason | None = None

    def begin(self, frame: Frame, calibration: CalibrationFilter) -> None:
        """Let the filter begin from the file, at the first frame; later frames change nothing."""
        if self._camera:
            return
        self._camera = camera_id(frame, self._mount)
        try:
            kept = _read(self._file, self._camera)
        except FileNotFoundError:
            return
        except (OSError, ValueError) as error:
            self._foreign = isinstance(error, ForeignFileError)
            self.reason = Reason(ReasonCode.CALIBRATION_IGNORED, (str(error),))
        else:
            calibration.begin(kept)
            self.reason = Reason(ReasonCode.CALIBRATION_KEPT, (len(kept),))
        _LOG.info("%s: %s", self._file, self.reason.text())

    def update(self, now_s: float, calibration: CalibrationFilter, *, at_rest: bool, wrong: bool) -> None:
        """Write what is due.

        wrong: odometry is wrong now. Call it about once a second; never blocks.
        """
        self._wrong |= wrong
        if self._wrong or not self._camera:
            return
        if at_rest:
            self._moved = self._moved and not self._write(observed(calibration.summary()))
            self._waiting = None
            return
        self._moved = True
        if self._waiting is not None and now_s - self._waiting[0] >= _PROVEN_S:
            self._write(self._waiting[1])
            self._waiting = None
        if self._waiting is None:
            self._waiting = now_s, observed(calibration.summary())

    def close(self, calibration: CalibrationFilter) -> None:
        """Write the newest errors if the camera has moved since the last write, and wait for it."""
        if self._moved and not self._wrong:
            self._write(observed(calibration.summary()))
        self._executor.close()

    def _write(self, elements: Elements) -> bool:
        """Start a write. Return False if the one before is not done yet."""
        if self._pending is not None and not self._pending.done():
            return False
        if elements and not self._foreign:
            file, camera = self._file, self._camera
            self._pending = self._executor.submit(lambda: write(file, camera, elements), _WRITE_COST_S)
        return True


class NoKeptCalibration:
    """No file: a flight begins from nothing, and leaves nothing."""

    reason: Reason | None = None

    def begin(self, frame: Frame, calibration: CalibrationFilter) -> None:
        """Do nothing."""

    def update(self, now_s: float, calibration: CalibrationFilter, *, at_rest: bool, wrong: bool) -> None:
        """Do nothing."""

    def close(self, calibration: CalibrationFilter) -> None:
        """Do nothing."""


def camera_id(frame: Frame, mount: str) -> str:
    """Return a short hash of intrinsics, sizes, relative pose and mount of a camera."""
    geometry = (frame.depth_intrinsics, frame.rgb_intrinsics, *frame.rgb_from_depth.quat_wxyz.tolist())
    text = f"{mount} {geometry} {frame.rgb_from_depth.translation_m.tolist()}"
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def write(file: Path, camera: str, elements: Elements) -> None:
    """Replace the file, atomically, also across a loss of power.

    A folder that cannot be written is logged and changes nothing.
    """
    tree = {"format": _FORMAT, "camera": camera, "elements": {name: [value, sigma] for name, value, sigma in elements}}
    try:
        # durable: a vehicle is often switched off right after its flight
        atomic_file.replace(file, (json.dumps(tree, indent=1) + "\n").encode("ascii"), durable=True)
    except OSError as error:
        _LOG.warning("%s: cannot be written (%s)", file, error.strerror)


def is_calibration(file: Path) -> bool:
    """Return True if a flight could have left this file, with any camera. Raises OSError."""
    try:
        _parse(file)
    except ForeignFileError:
        return False
    return True


def _read(file: Path, camera: str) -> Elements:
    """Return the errors in a file.

    Raises FileNotFoundError if there is none; OSError, or ValueError with a short text, if it cannot be used.
    """
    found, kept = _parse(file)
    if found != (_FORMAT, camera):
        raise ValueError("it is of another camera or mount")
    fault = kept_fault(kept)
    if fault:
        raise ValueError(fault)
    return kept


def _parse(file: Path) -> tuple[tuple[object, object], Elements]:
    """Return format and camera of a file, and the errors in it.

    Raises OSError or ForeignFileError.
    """
    try:
        tree = json.loads(file.read_bytes())
        kept = tuple((str(name), float(value), float(sigma)) for name, (value, sigma) in tree["elements"].items())
        return (tree["format"], tree["camera"]), kept
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
        raise ForeignFileError("no calibration file") from None
