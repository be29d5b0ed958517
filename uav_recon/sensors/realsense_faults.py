"""Firmware and SDK versions of RealSense cameras that are known to be bad.

Each with a public report.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

Version = tuple[int, ...]
_ISSUES = "https://github.com/realsenseai/librealsense/issues/"
_ROS_ISSUES = "https://github.com/realsenseai/realsense-ros/issues/"


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownFault:
    """A range of firmware and SDK versions with a fault.

    firmware_from, firmware_below: first bad and first good firmware. sdk_from, sdk_below: the same of the SDK; () for no bound.
    models: words in the name of the camera; () for all. source: address of the report.
    """

    effect: str
    remedy: str
    source: str
    firmware_from: Version = ()
    firmware_below: Version = ()
    sdk_from: Version = ()
    sdk_below: Version = ()
    models: tuple[str, ...] = ()

    def fits(self, name: str, firmware: Version, sdk: Version) -> bool:
        """Return True for a camera with this fault."""
        model = not self.models or any(word.lower() in name.lower() for word in self.models)
        return (
            model and _within(firmware, self.firmware_from, self.firmware_below) and _within(sdk, self.sdk_from, self.sdk_below)
        )


KNOWN_FAULTS = (
    KnownFault(
        firmware_from=(5, 11, 1, 0), firmware_below=(5, 11, 1, 100), effect="no stream starts, depth options are invalid",
        remedy="update the firmware to 5.11.6.200 or later", source=_ISSUES + "3137",
    ),
    KnownFault(
        firmware_from=(5, 11, 1, 0), firmware_below=(5, 11, 6, 200), effect="single depth frames are all zero",
        remedy="update the firmware to 5.11.6.200 or later", source=_ISSUES + "3786",
    ),
    KnownFault(
        firmware_below=(5, 12, 0, 0), models=("D435I",),
        effect="inertial samples are lost", remedy="update the firmware to 5.12.0.0 or later", source=_ISSUES + "5298",
    ),
    KnownFault(
        firmware_from=(5, 12, 8, 200), firmware_below=(5, 12, 8, 201), effect="depth does not start until it is replugged",
        remedy="use firmware 5.12.7.100 or a later one", source=_ISSUES + "7594",
    ),
    KnownFault(
        firmware_from=(5, 15, 1, 0), firmware_below=(5, 16, 0, 0), sdk_below=(2, 54, 2),
        effect="the firmware is newer than the SDK supports", remedy="update the SDK to 2.54.2 or later",
        source=_ISSUES + "5052",
    ),
    KnownFault(
        firmware_from=(5, 16, 0, 0), sdk_below=(2, 55, 1), effect="depth does not start, no inertial samples",
        remedy="update the SDK to 2.55.1, or go back to firmware 5.13.0.50", source=_ROS_ISSUES + "1533",
    ),
)  # fmt: skip


def version_of(text: str) -> Version:
    """Return the numbers of a version such as '05.16.00.01'; () if there are none."""
    return tuple(int(number) for number in re.findall(r"\d+", text))


def known_faults(name: str, firmware: str, sdk: str) -> list[KnownFault]:
    """Return the known faults of a camera with this name, firmware and SDK.

    None if its firmware is not known.
    """
    number = version_of(firmware)
    return [fault for fault in KNOWN_FAULTS if number and fault.fits(name, number, version_of(sdk))]


def _within(version: Version, first: Version, below: Version) -> bool:
    """Return True if a version is in a range.

    An unknown version is in every range without bounds only.
    """
    if not version:
        return not first and not below
    return version >= first and (not below or version < below)
