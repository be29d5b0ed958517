"""Perception status: what perception rejected since it started, by reason."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode


@dataclass(frozen=True, slots=True)
class PerceptionStatus:
    """Counts of perception since its start, and its newest rejection of a depth frame.

    frames: depth frames that were given on. rejected_frames: (reason, count) of the others. rejected_samples: (reason as text,
    count) of rejected poses and inertial samples. newest: None before the first rejected frame; newest_s: its stamp.
    origin: where the take-off pad is, if not at the pose source's origin, or that it is awaited. calibration: errors of the
    camera as known now, each with its name and unit, its value and its standard deviation. camera: remarks about the camera:
    its streams, and what is wrong with it. kept: None, or that these errors began from those of an earlier flight, or why a
    file of them is not used. correction: of the odometry, for a drift of the pose source; None for none. earlier_map: whether
    this flight was found in the map of an earlier one, and where it began there; None without one.
    """

    stamp_s: float
    frames: int = 0
    rejected_frames: tuple[tuple[ReasonCode, int], ...] = ()
    rejected_samples: tuple[tuple[str, int], ...] = ()
    newest: Reason | None = None
    newest_s: float = -math.inf
    origin: Reason | None = None
    calibration: tuple[tuple[str, float, float], ...] = ()
    camera: tuple[Reason, ...] = ()
    kept: Reason | None = None
    correction: Reason | None = None
    earlier_map: Reason | None = None

    def counts(self) -> dict[str, int]:
        """Return all counts of rejections by name.

        A name is the code of a frame's reason, or "pose" or "imu" and the reason of a sample.
        """
        frames = {code.value: count for code, count in self.rejected_frames}
        return frames | {
            reason if reason.startswith("imu ") else f"pose {reason}": count for reason, count in self.rejected_samples
        }
