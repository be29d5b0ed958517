"""A process that waits for another one says so on standard error, after two seconds and periodically."""

from __future__ import annotations

import numpy as np
import pytest

from uav_recon.app.flight_channels import memory_channels
from uav_recon.app.wait_notice import WaitNotice, missing_processes
from uav_recon.types.pose import Pose, StampedPose

PILOT, PERCEPTION = "the pilot (uav-recon pilot)", "perception (uav-recon perception)"


def printed(waiting: list[tuple[float, list[str]]], capsys: pytest.CaptureFixture[str]) -> list[str]:
    notice = WaitNotice("mission", waiting[0][0])
    for now_s, missing in waiting:
        notice.update(now_s, missing)
    return capsys.readouterr().err.splitlines()


def test_the_first_line_comes_after_two_seconds_and_then_every_fifteen(capsys: pytest.CaptureFixture[str]) -> None:
    turns = [(10.0 + 0.5 * n, [PILOT, PERCEPTION]) for n in range(80)]
    assert printed(turns, capsys) == [
        f"uav-recon mission: waiting for {PILOT} and {PERCEPTION}: {seconds} s" for seconds in (2, 17, 32)
    ]


def test_a_change_is_printed_at_once_and_an_arrival_ends_the_wait(capsys: pytest.CaptureFixture[str]) -> None:
    turns: list[tuple[float, list[str]]] = [
        *((n * 0.5, [PILOT, PERCEPTION]) for n in range(6)),
        (3.0, [PERCEPTION]),
        (3.5, []),
        (4.0, [PILOT]),
        (5.0, [PILOT]),
    ]
    assert printed(turns, capsys) == [
        f"uav-recon mission: waiting for {PILOT} and {PERCEPTION}: 2 s",
        f"uav-recon mission: waiting for {PERCEPTION}: 3 s",
    ]


def test_a_process_whose_newest_value_is_old_is_missing() -> None:
    channels = memory_channels()
    assert missing_processes(channels, 10.0) == [PILOT, PERCEPTION]
    channels.odom.publish(StampedPose(10.0, Pose.identity(), np.zeros(3)))
    assert missing_processes(channels, 11.9) == [PILOT]
    assert missing_processes(channels, 12.1) == [PILOT, PERCEPTION]
