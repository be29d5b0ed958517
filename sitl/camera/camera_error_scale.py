"""Scale of the camera errors that a seed draws, as typed: none, default or a factor."""

from __future__ import annotations

import math

DEFAULT = "default"  # errors of a flight without --camera-errors
WORDS = {"none": 0.0, "default": 1.0}
DEFAULT_SCALE = WORDS[DEFAULT]
MAX_SCALE = 2.0


def scale_of(text: str | None) -> float:
    """Return the scale of `--camera-errors`; None is the option left out.

    Raises ValueError with what is wanted.
    """
    word = DEFAULT if text is None else text
    try:
        scale = WORDS[word] if word in WORDS else float(word)
    except ValueError:
        scale = math.nan
    if not 0.0 <= scale <= MAX_SCALE:
        raise ValueError(f"want {', '.join(WORDS)} or a factor of 0 to {MAX_SCALE:g}")
    return scale
