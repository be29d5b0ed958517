"""`uav-recon check realsense` on librealsense's software device."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from software_realsense import HARDWARE, SYSTEM, SoftwareRealSense

from uav_recon.app.realsense_check import check_realsense
from uav_recon.clock import ManualClock
from uav_recon.errors import UserError

SIZE = (424, 240, 30)


class _Bench(ManualClock):
    """Time passes in sleep, and the camera sends what is due."""

    def __init__(self, **device: Any) -> None:
        super().__init__(100.0)
        self.source = SoftwareRealSense(self, **device)
        self.sends, self.depth_mm, self.domain, self.late_s = True, 2000, HARDWARE, 0.01
        self.frozen = False
        self.rng = np.random.default_rng(1)
        self._sent = self._sampled = 0

    def sleep_until(self, instant_s: float) -> None:
        self.advance_to(instant_s)
        size = next(iter(self.source.depth)) if SIZE not in self.source.depth else SIZE
        while self.sends and self._sent < (self.now_s() - 100.0) * size[2]:
            self._sent += 1
            self.source.send(size, size, self.now_s() - self.late_s, self.domain, self.depth_mm)
        while self._sampled < (self.now_s() - 100.0) * 200 and self.source.has_imu:
            self._sampled += 1
            noise = np.zeros(3) if self.frozen else self.rng.normal(0.0, 0.01, 3)
            force = noise + np.array([0.0, -9.81, 0.1])
            self.source.send_motion(self.now_s() - 0.002, gyro=noise.tolist(), force=force.tolist())

    def check(self, **options: Any) -> tuple[int, list[str]]:
        lines: list[str] = []
        code = check_realsense(self, lines.append, devices=lambda: [self.source.device], **options)
        return code, lines


def _wrong(lines: list[str]) -> list[str]:
    return [line[2:] for line in lines if line.startswith("! ")]


def test_a_good_camera_is_described_and_nothing_is_wrong() -> None:
    bench = _Bench()
    bench.source.set_emitter(True)
    code, lines = bench.check()
    assert (code, _wrong(lines)) == (0, [])
    text = "\n".join(lines)
    assert "device      Intel RealSense D435I, serial 146322070000" in text
    assert "firmware    5.16.0.1 with SDK 2." in text
    assert "offers      depth: 424x240 at 15 Hz, 424x240 at 30 Hz, 480x270 at 30 Hz, 848x480 at 30 Hz" in text
    assert "chosen      depth 424x240 at 30 Hz (the first choice)" in text
    assert "clocks      accel hardware clock, colour hardware clock, depth hardware clock, gyro hardware clock" in text
    assert "emitter     on" in text
    assert lines[-1] == "nothing is wrong"


def test_each_fault_is_named_with_its_remedy() -> None:
    bench = _Bench(usb="2.1", firmware="5.11.1.100", depth=((480, 270, 15),), colour=((480, 270, 15),))
    bench.depth_mm, bench.domain, bench.frozen = 0, SYSTEM, True
    bench.source.set_emitter(False)
    code, lines = bench.check()
    assert code == 1
    wrong = _wrong(lines)
    for words in (
        "USB 2.1: 15 frames a second, later than on USB 3; use a USB 3 port and cable",
        "5.11.1.100 with SDK", "arrival times (system time)", "infrared emitter is off",
        "returns in 0% of the depth pixels: uncover and clean the lens", "the gyro repeats one value: plug the camera in again",
    ):  # fmt: skip
        assert any(words in line for line in wrong), words
    assert lines[-1] == f"{len(wrong)} to look at"


def test_a_camera_without_imu_and_one_without_frames_are_named() -> None:
    code, lines = _Bench(imu_hz=None).check()
    assert code == 1
    assert _wrong(lines) == ["the camera offers no IMU: on JetPack 6 install an SDK with the RSUSB backend"]
    silent = _Bench()
    silent.sends = False
    code, lines = silent.check()
    assert code == 1
    assert "no frame" in _wrong(lines)[-1]


def test_no_camera_is_one_line() -> None:
    with pytest.raises(UserError, match=r"^RealSense camera of any serial is not connected \(seen: none\)$"):
        check_realsense(ManualClock(1.0), lambda _: None, devices=lambda: [])
