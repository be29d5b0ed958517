"""Words that options with a fixed set of values take, for help and shell completion.

The command that uses an option checks its value.
"""

from __future__ import annotations

from collections.abc import Callable

POSES = ("stream", "corrected", "slam", "autopilot")
AUTOPILOTS = ("px4", "ardupilot")
VARIANTS = ("adaptive", "merged", "reconstruct", "explore", "explore-yaw", "explore-then-refine", "evpp", "vpp")
DEPTH_NOISES = ("d435i", "paper", "kinect", "none")
CAMERAS = ("d435i", "wide", "fast", "small")
MAPPERS = ("neural", "depth-only")
UNCERTAINTIES = ("agreement", "paper", "colour", "information", "product")
MOUNTS = ("fixed:15", "fixed:0", "gimbal")
SIM_MOUNTS = ("auto", *MOUNTS)
TRACKERS = ("joint", "open3d")
SEQUENCE_FAULTS = ("dark", "low-contrast", "blur", "fast-yaw", "glass", "covered", "frozen", "false-wall")
CAMERA_ERRORS = ("default", "none")
DEVICES = ("auto", "cpu", "cuda")


# of an option
CAMERA_ERRORS_HELP = (
    "Errors of the camera, drawn from the seed: mount, lens and colour calibration, depth scale, delay, rolling shutter, "
    "exposure, IMU noise and lost frames. A factor of 0 to 2 scales all; none: an exact camera. Default: default, which is 1."
)


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
