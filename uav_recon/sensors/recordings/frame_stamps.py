"""Stamps of the frames of a recording: which frames can be used, and in which order.

A recording is read as the live camera would be: two frames in the wrong order are sorted, a repeated stamp is left out, and of
the parts between two jumps of the clock the longest is used. Stamps that count no seconds are refused.
"""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from uav_recon.sensors.recordings.recording import RecordingError

_MAX_GAP_S = 600.0  #: reject: the frames before or after a longer gap, the fewer of them: the clock has jumped
_BACK_S = 1.0  #: reject: ... and before or after a step back by more; frames within it are sorted
_MAX_BACK_STEPS = 3  #: reject: a recording with more of them: its frames have no order
_UNSORTED_SHARE = 0.1  #: reject: a recording with this share of stamps older than the one before: they count no seconds
_MIN_RATE_HZ = 1.0  #: reject: a recording with fewer frames a second: its stamps count no seconds
_MAX_RATE_HZ = 300.0  #: reject: ... with more
_UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}


@dataclass(frozen=True)
class UsedFrames:
    """Frames that are used.

    order: their positions in the list, by increasing stamp. stamps_s: their stamps. skipped: count of the others, by reason.
    remarks: one line for each jump of the clock. is_part: True if a part of the recording is used.
    """

    order: tuple[int, ...]
    stamps_s: tuple[float, ...]
    skipped: dict[str, int]
    remarks: tuple[str, ...] = ()

    @property
    def is_part(self) -> bool:
        """True if frames are left out at a jump of the clock."""
        return bool(self.remarks)


def used_frames(path: Path, stamps_s: Sequence[float]) -> UsedFrames:
    """Choose the frames of a recording by their stamps, in the order of its list.

    Raises RecordingError (one line) without a frame, and for stamps that count no seconds.
    """
    finite = [number for number, stamp_s in enumerate(stamps_s) if math.isfinite(stamp_s)]
    if not finite:
        raise RecordingError(f"{path}: has no depth frame")
    _require_seconds(path, [stamps_s[number] for number in finite])
    near = _without_outliers(finite, stamps_s)
    parts = _parts(near, stamps_s)
    used = max(parts, key=len)
    remarks = _jumps(path, parts, used, stamps_s)
    order = sorted(used, key=lambda number: (stamps_s[number], number))
    newer = [order[0], *(b for a, b in itertools.pairwise(order) if stamps_s[b] > stamps_s[a])]
    counts = {
        "frames whose stamp is no number": len(stamps_s) - len(finite),
        "frames whose stamp is far from those beside it": len(finite) - len(near),
        "frames at a jump of the stamps": len(near) - len(used),
        "frames with the stamp of another": len(order) - len(newer),
    }
    skipped = {reason: count for reason, count in counts.items() if count}
    return UsedFrames(tuple(newer), tuple(stamps_s[number] for number in newer), skipped, remarks)


def require_increasing(path: Path, stamps_s: Sequence[float]) -> None:
    """Check the stamps of a file that this project writes.

    Raises RecordingError if there are none, if they do not increase, or for a gap of over ten minutes.
    """
    if not stamps_s:
        raise RecordingError(f"{path}: has no depth frame")
    if not math.isfinite(stamps_s[0]):
        raise RecordingError(f"{path}: the first stamp is {stamps_s[0]}")
    for before_s, after_s in itertools.pairwise(stamps_s):
        if not before_s < after_s or not math.isfinite(after_s):
            raise RecordingError(f"{path}: stamps must increase, and {after_s:.6f} s follows {before_s:.6f} s")
        if after_s - before_s > _MAX_GAP_S:
            raise RecordingError(
                f"{path}: gap of {after_s - before_s:.4g} s after {before_s:.3f} s; want at most {_MAX_GAP_S:g} s"
            )


def _require_seconds(path: Path, stamps_s: list[float]) -> None:
    """Raise RecordingError for stamps that are equal, out of order, or count no seconds."""
    steps_s = [after_s - before_s for before_s, after_s in itertools.pairwise(stamps_s) if after_s != before_s]
    if len(stamps_s) < 2:
        return
    if not steps_s:
        raise RecordingError(f"{path}: all {len(stamps_s)} stamps are {stamps_s[0]:g} s; want stamps that increase")
    back = sum(step_s < 0.0 for step_s in steps_s)
    far_back = sum(step_s < -_BACK_S for step_s in steps_s)
    if back > max(_UNSORTED_SHARE * len(steps_s), 1) or far_back > _MAX_BACK_STEPS:
        raise RecordingError(
            f"{path}: stamps are out of order: {back} of {len(stamps_s)} are older than the one before; "
            "want stamps of the capture in seconds, not durations, in the order of the frames"
        )
    rate_hz = 1.0 / statistics.median_low(map(abs, steps_s))
    if _MIN_RATE_HZ <= rate_hz <= _MAX_RATE_HZ:
        return
    named = next((unit for unit, count in _UNITS.items() if _MIN_RATE_HZ <= rate_hz * count <= _MAX_RATE_HZ), None)
    guess = f"; they look like {named}, divide them by {_UNITS[named]:.0f}" if named else ""
    raise RecordingError(
        f"{path}: {len(stamps_s)} frames in {max(stamps_s) - min(stamps_s):.4g} s are {rate_hz:.4g} a second by their stamps; "
        f"want stamps in seconds, {_MIN_RATE_HZ:g} to {_MAX_RATE_HZ:g} frames a second{guess}"
    )


def _without_outliers(numbers: list[int], stamps_s: Sequence[float]) -> list[int]:
    """Leave out each frame whose stamp is far from its neighbours, if those are near each other."""
    kept = numbers[:1]
    for number, after in itertools.pairwise([*numbers[1:], numbers[-1]]):
        before_s, stamp_s, after_s = stamps_s[kept[-1]], stamps_s[number], stamps_s[after]
        near = -_BACK_S <= after_s - before_s <= _MAX_GAP_S
        if not near or before_s - _BACK_S <= stamp_s <= after_s + _BACK_S:
            kept.append(number)
    return kept


def _parts(numbers: list[int], stamps_s: Sequence[float]) -> list[list[int]]:
    """Split the frames at each jump of the stamps."""
    parts = [[numbers[0]]]
    for before, after in itertools.pairwise(numbers):
        if not -_BACK_S <= stamps_s[after] - stamps_s[before] <= _MAX_GAP_S:
            parts.append([])
        parts[-1].append(after)
    return parts


def _jumps(path: Path, parts: list[list[int]], used: list[int], stamps_s: Sequence[float]) -> tuple[str, ...]:
    """Return a line for each jump, and what part is used.

    Raises RecordingError if another part has stamps of the used one: poses cannot be told apart.
    """
    if len(parts) == 1:
        return ()
    spans_s = [(min(stamps_s[number] for number in part), max(stamps_s[number] for number in part)) for part in parts]
    first_s, last_s = spans_s[parts.index(used)]
    jumps = []
    for before, after in itertools.pairwise(parts):
        step_s = stamps_s[after[0]] - stamps_s[before[-1]]
        jumps.append(f"{'gap' if step_s > 0 else 'step back'} of {abs(step_s):.4g} s after {stamps_s[before[-1]]:.3f} s")
    for part, (begin_s, end_s) in zip(parts, spans_s, strict=True):
        if part is not used and begin_s <= last_s and end_s >= first_s:
            raise RecordingError(f"{path}: {jumps[0]}: several frames for the same time; cut the recording there")
    total = sum(map(len, parts))
    return (f"{'; '.join(jumps[:3])}: used {len(used)} of {total} frames, {first_s:.3f} to {last_s:.3f} s",)
