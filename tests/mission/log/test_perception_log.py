"""What perception rejects is written when it is new, and else rarely."""

from __future__ import annotations

from pathlib import Path

from uav_recon.channels import MemoryChannel
from uav_recon.mission.log.perception_log import PERIOD_S, PerceptionLog
from uav_recon.recording.flight_log import FlightLog, read_timeline
from uav_recon.types.perception_status import PerceptionStatus
from uav_recon.types.reason import Reason
from uav_recon.types.reason_code import ReasonCode

EMPTY, NOISE = ReasonCode.DEPTH_FRAME_EMPTY, ReasonCode.DEPTH_FRAME_NOISE


def test_a_new_reason_is_written_at_once_and_more_of_it_every_ten_seconds(tmp_path: Path) -> None:
    channel, journal = MemoryChannel(PerceptionStatus), FlightLog(tmp_path)
    log = PerceptionLog(channel, journal)
    log.step(0.0)
    for second in range(26):
        frames: tuple[tuple[ReasonCode, int], ...] = ((EMPTY, second),) if second else ()
        frames += ((NOISE, 1),) if second >= 13 else ()
        channel.publish(PerceptionStatus(float(second), 6 * second, frames, (), Reason(EMPTY, (0.04,)), float(second)))
        log.step(float(second))
    log.close()
    journal.close()
    written = read_timeline(tmp_path).perception
    assert [record.stamp_s for record in written] == [1.0, 11.0, 13.0, 23.0, 25.0]
    assert PERIOD_S == 10.0
    assert written[-1].counts == (("depth-frame-empty", 25), ("depth-frame-noise", 1))
    assert written[-1].frames == 150
    assert written[-1].newest == "depth frame: returns in 4% of the pixels"


def test_the_pad_and_the_camera_are_written_when_they_are_known(tmp_path: Path) -> None:
    channel, journal = MemoryChannel(PerceptionStatus), FlightLog(tmp_path)
    log = PerceptionLog(channel, journal)
    awaited, found = Reason(ReasonCode.PAD_AWAITED, (0.5,)), Reason(ReasonCode.PAD_IS_ORIGIN, (2.0, 30.0))
    usb2 = Reason(ReasonCode.CAMERA_USB2, ("2.1", "15"))
    states = [(awaited, ()), (awaited, ()), (found, ()), (found, (usb2,)), (found, (usb2,)), (found, ())]
    for second, (origin, camera) in enumerate(states):
        channel.publish(PerceptionStatus(float(second), origin=origin, camera=camera))
        log.step(float(second))
    journal.close()
    written = read_timeline(tmp_path).perception
    assert [record.stamp_s for record in written] == [0.0, 2.0, 3.0]
    assert written[2].camera == (usb2.text(),)


def test_a_flight_in_which_nothing_was_rejected_says_so(tmp_path: Path) -> None:
    channel, journal = MemoryChannel(PerceptionStatus), FlightLog(tmp_path)
    log = PerceptionLog(channel, journal)
    log.close()
    channel.publish(PerceptionStatus(5.0, 30))
    log.step(5.0)
    log.close()
    journal.close()
    assert [(record.frames, record.counts) for record in read_timeline(tmp_path).perception] == [(30, ())]
