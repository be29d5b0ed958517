"""Exposure and white balance: automatic on the ground, locked in flight, and never without a word."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pyrealsense2 as rs
import pytest
from software_realsense import Rig, SoftwareRealSense

from uav_recon.clock import InlineExecutor, ManualClock
from uav_recon.sensors.exposure_lock import ExposureLock
from uav_recon.types.reason import Reason, codes_of
from uav_recon.types.reason_code import ReasonCode

OPTION = rs.option
CONTROLS = {
    OPTION.enable_auto_exposure: 1.0, OPTION.enable_auto_white_balance: 1.0, OPTION.exposure: 156.0, OPTION.gain: 64.0,
    OPTION.white_balance: 4600.0,
}  # fmt: skip
LOCKED = Reason(ReasonCode.EXPOSURE_LOCKED, (156.0, 4600.0))


class _Controls:
    """A device that keeps, changes or refuses its exposure."""

    def __init__(self) -> None:
        self.locked = False
        self.error = ""

    def lock(self) -> tuple[float, float]:
        if self.error:
            raise OSError(self.error)
        self.locked = True
        return 156.0, 4600.0

    def release(self) -> None:
        self.locked = False


class _Hanging:
    def submit(self, work: Callable[[], Any], cost_s: float) -> Any:
        return self

    def done(self) -> bool:
        return False

    def close(self) -> None: ...


class _Ground:
    """A lock that is stepped at 30 Hz."""

    def __init__(self, executor: Any = None) -> None:
        self.clock, self.controls = ManualClock(50.0), _Controls()
        self.lock = ExposureLock(self.controls, executor or InlineExecutor(self.clock), OSError, 50.0)

    def run(self, seconds: float, near: bool, brightness: float = 100.0) -> Reason | None:
        for _ in range(round(30 * seconds)):
            self.clock.advance_to(self.clock.now_s() + 1 / 30)
            self.lock.step(self.clock.now_s(), near, brightness)
        return self.lock.reason


def test_it_is_automatic_until_the_flight_is_near_and_after_it() -> None:
    ground = _Ground()
    assert ground.run(60.0, near=False) is None
    assert [ground.controls.locked] == [False]
    assert ground.run(0.1, near=True) == LOCKED
    ground.run(120.0, near=True)
    assert [ground.controls.locked] == [True]
    assert ground.run(4.9, near=False) == LOCKED  # a short stop of the motors is no end
    assert ground.run(0.5, near=False) is None
    assert not ground.controls.locked


def test_an_exposure_that_had_no_time_to_settle_stays_automatic_in_words() -> None:
    ground = _Ground()
    assert codes_of(ground.run(1.0, near=True)) == ("exposure-not-locked",)
    assert not ground.controls.locked
    ground.run(60.0, near=True)
    assert not ground.controls.locked  # nothing changes in the air


@pytest.mark.parametrize("change", [0.5, 2.0])
def test_an_image_that_changes_at_the_lock_is_released_in_words(change: float) -> None:
    ground = _Ground()
    ground.run(5.0, near=False)
    ground.run(0.1, near=True)
    reason = ground.run(0.6, near=True, brightness=100.0 * change)
    assert reason == Reason(ReasonCode.EXPOSURE_NOT_LOCKED, (f"the brightness changed by {change:.2f} at the lock",))
    assert not ground.controls.locked


def test_what_an_earlier_process_left_locked_is_released_on_the_ground_only() -> None:
    for near in (False, True):
        ground = _Ground()
        ground.controls.locked = True
        ground.run(0.1, near=near)
        assert ground.controls.locked is near


def test_a_device_that_refuses_is_said() -> None:
    ground = _Ground()
    ground.controls.error = "the colour camera stays automatic"
    ground.run(5.0, near=False)
    assert ground.run(0.1, near=True) == Reason(ReasonCode.EXPOSURE_NOT_LOCKED, ("the colour camera stays automatic",))


def test_a_device_that_hangs_is_said_and_blocks_nothing() -> None:
    ground = _Ground(_Hanging())
    ground.run(5.0, near=False)
    assert ground.run(2.9, near=True) is None
    assert ground.run(0.2, near=True) == Reason(ReasonCode.EXPOSURE_NOT_LOCKED, ("no answer within 3 s",))


def test_the_colour_sensor_of_librealsense_is_locked_and_released() -> None:
    rig = Rig(SoftwareRealSense(ManualClock(100.0), controls=CONTROLS))
    sensor, near = rig.source.device.query_sensors()[1], [False]
    rig.camera.lock_exposure(lambda: near[0])
    rig.run(3.0)
    assert sensor.get_option(OPTION.enable_auto_exposure) == 1.0
    near[0] = True
    rig.run(1.0)
    values = [sensor.get_option(name) for name in CONTROLS]
    np.testing.assert_allclose(values, [0.0, 0.0, 156.0, 64.0, 4600.0])
    assert rig.camera.remarks()[-1] == LOCKED
    near[0] = False
    rig.run(6.0)
    assert [sensor.get_option(name) for name in (OPTION.enable_auto_exposure, OPTION.enable_auto_white_balance)] == [1.0, 1.0]


def test_a_colour_sensor_without_controls_is_a_warning() -> None:
    rig = Rig(SoftwareRealSense(ManualClock(100.0)))
    near = [False]
    rig.camera.lock_exposure(lambda: near[0])
    rig.run(3.0)
    near[0] = True
    frames = rig.run(1.0)
    assert len(frames) == 30
    wanted = Reason(ReasonCode.EXPOSURE_NOT_LOCKED, ("the colour camera has no such control",))
    assert rig.camera.remarks()[-1] == wanted
