"""Words that options with a fixed set of values take, for help and shell completion.

The command that uses an option checks its value.
"""

from __future__ import annotations

from collections.abc import Callable

AUTOPILOTS = ("px4", "ardupilot")
TRACKERS = ("joint", "open3d")
SEQUENCE_FAULTS = ("black", "dark", "low-contrast", "blur", "fast-yaw", "glass", "covered", "frozen", "false-wall")
DEVICES = ("auto", "cpu", "cuda")


def one_of(words: tuple[str, ...]) -> Callable[[str], list[str]]:
    """Return a completion for the last word of a comma-separated list.

    It offers the words that begin with it.
    """

    def complete(incomplete: str) -> list[str]:
        before, comma, last = incomplete.rpartition(",")
        return [f"{before}{comma}{word}" for word in words if word.startswith(last)]

    return complete


def listed(words: tuple[str, ...]) -> str:
    """Return the words for a help text: `a|b|c`."""
    return "|".join(words)
