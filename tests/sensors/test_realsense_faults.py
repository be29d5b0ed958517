"""Versions of firmware and SDK that are known to be bad."""

from __future__ import annotations

from pathlib import Path

import pytest

from uav_recon.sensors.realsense_faults import KNOWN_FAULTS, known_faults, version_of

ROOT = Path(__file__).parents[2]
D435, D435I = "Intel RealSense D435", "Intel RealSense D435I"


@pytest.mark.parametrize(
    ("name", "firmware", "sdk", "effects"),
    [
        (D435, "05.11.01.100", "2.59.1", ["single depth frames are all zero"]),
        (D435, "5.11.1.0", "2.18.0", ["no stream starts, depth options are invalid", "single depth frames are all zero"]),
        (D435I, "5.11.1.100", "2.59.1", ["single depth frames are all zero", "inertial samples are lost"]),
        (D435I, "5.11.15.0", "2.59.1", ["inertial samples are lost"]),
        (D435, "5.11.15.0", "2.59.1", []),
        (D435I, "5.12.8.200", "2.59.1", ["depth does not start until it is replugged"]),
        (D435I, "5.15.1.0", "2.50.0", ["the firmware is newer than the SDK supports"]),
        (D435I, "5.16.0.1", "2.50.0", ["depth does not start, no inertial samples"]),
        (D435I, "5.16.0.1", "2.55.1", []),
        (D435I, "5.13.0.50", "2.50.0", []),
        (D435I, "", "2.59.1", []),
    ],
)
def test_known_bad_pairs_are_found(name: str, firmware: str, sdk: str, effects: list[str]) -> None:
    assert [fault.effect for fault in known_faults(name, firmware, sdk)] == effects


def test_each_entry_has_a_source_and_a_remedy_in_one_line() -> None:
    for fault in KNOWN_FAULTS:
        assert fault.source.startswith("https://github.com/realsenseai/")
        assert fault.remedy
        assert "\n" not in fault.effect + fault.remedy


def test_the_page_lists_each_entry() -> None:
    rows = [line for line in (ROOT / "docs" / "realsense.md").read_text(encoding="utf-8").splitlines() if "](https" in line]
    for fault in KNOWN_FAULTS:
        bounds = [".".join(map(str, version)) for version in (fault.firmware_from, fault.firmware_below) if version]
        (row,) = [row for row in rows if fault.effect in row]
        assert all(text in row for text in (*bounds, fault.remedy, fault.source))


def test_versions_are_compared_as_numbers() -> None:
    assert version_of("05.9.14.00") == (5, 9, 14, 0)
    assert version_of("5.9.14") < version_of("5.12.0")
    assert version_of("unknown") == ()
